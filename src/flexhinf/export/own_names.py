"""Names that a C file keeps to itself begin with its name, so that several exports may be compiled as one file."""

from __future__ import annotations

import re

#: Comments and strings, which stay as they are, or a name that is no member of a structure.
TOKEN = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"|(?<![\w.>])([A-Za-z_]\w*)(\(?)', re.DOTALL)

#: A static function or table at the beginning of a line, or the end of a table of structures.
STATIC = re.compile(r"^(?:static\b[^=;({]*?\b|\} )(\w+)(\(|\[)", re.MULTILINE)

#: Constants between the braces of an enumeration.
ENUMERATION = re.compile(r"^enum \{\n(.*?)^\};", re.MULTILINE | re.DOTALL)

#: A macro that a file defines.
MACRO = re.compile(r"^#define (\w+)", re.MULTILINE)


def with_own_names(text: str, name: str) -> str:
    """C whose static functions, tables and constants begin with the name, and whose other macros end with the file.

    Every name is followed to wherever it stands, but for members of structures.
    """
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    starts = (name, name.upper())
    constants = [
        one for part in ENUMERATION.findall(code) for one in re.findall(r"^\s*(\w+) = ", part, re.MULTILINE)
    ]
    static = dict(STATIC.findall(code))
    own = dict.fromkeys(one for one in [*static, *constants] if not one.startswith(starts))
    known = set(re.findall(r"\w+", text))
    for one in own:
        longer = f"{name.upper()}_{one}" if one.isupper() else f"{name}_{one}"
        while longer in known:
            longer += "_"
        own[one] = longer

    def renamed(found: re.Match[str]) -> str:
        word, bracket = found[1], found[2]
        if word not in own or (static.get(word) == "(" and not bracket):  # a variable beside a function
            return found[0]
        return f"{own[word]}{bracket}"

    macros = dict.fromkeys(macro for macro in MACRO.findall(code) if not macro.startswith(starts))
    ends = "".join(f"#undef {macro}\n" for macro in macros)
    return TOKEN.sub(renamed, text).rstrip("\n") + f"\n\n/* These names are of this file alone. */\n{ends}"
