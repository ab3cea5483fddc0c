{# What every exported header has behind its first comment: a line here stands in all of them. #}
#ifndef @{guard}
#define @{guard}
