"""Words that other texts become in C, and those that no name may be."""

from __future__ import annotations

import re
from collections.abc import Hashable, Sequence

from flexhinf.codegen.naming import Names

_KEYWORDS = """
    alignas alignof and and_eq asm auto bitand bitor bool break case catch char char8_t char16_t char32_t class compl
    concept const const_cast consteval constexpr constinit continue co_await co_return co_yield decltype default delete
    do double dynamic_cast else enum explicit export extern false float for friend goto if inline int long main mutable
    namespace new noexcept not not_eq nullptr operator or or_eq private protected public register reinterpret_cast
    requires restrict return short signed sizeof static static_assert static_cast struct switch template this
    thread_local throw true try typedef typeid typename typeof union unsigned using virtual void volatile wchar_t while
    xor xor_eq
"""

_OF_DOUBLES = """
    acos acosh asin asinh atan atan2 atanh cbrt ceil copysign cos cosh erf erfc exp exp2 expm1 fabs fdim floor fma fmax
    fmin fmod frexp gamma hypot ilogb ldexp lgamma llrint llround log log10 log1p log2 logb lrint lround modf nan
    nearbyint nextafter nexttoward pow remainder remquo rint round scalbln scalbn signgam sin sinh sqrt tan tanh tgamma
    trunc j0 j1 jn y0 y1 yn
"""

_OTHERS = "fpclassify isfinite isinf isnan isnormal signbit memcmp memcpy memmove memset offsetof"

#: Words of C up to C23 and of C++ up to C++20, in which exported C is compiled too.
KEYWORDS = frozenset(_KEYWORDS.split())

#: Functions and macros of the headers that exported C includes; of <math.h> those of C99 and of POSIX.
LIBRARY = frozenset(
    [*(name + kind for name in _OF_DOUBLES.split() for kind in ("", "f", "l")), *_OTHERS.split()]
)

#: The last argument of a function that keeps rows between its loops, in memory of the caller.
ROWS = "rows"

#: Names that every function uses itself: counters, the number of lanes, and those rows.
LOCAL = frozenset({"count", "i", "l", ROWS})

#: Words that nothing of a model is called.
RESERVED = KEYWORDS | LIBRARY | LOCAL


def identifier(text: str) -> str:
    """A word of C that looks like the text; with an underscore behind one that is reserved or in capitals, as macros
    are."""
    word = re.sub(r"\W", "_", text, flags=re.ASCII).strip("_") or "value"
    word = word if word[0].isalpha() else f"of_{word}"
    return f"{word}_" if word.isupper() or word in RESERVED else word


def called_names(
    names: tuple[str, ...],
    read: int,
    written: int,
    shared: Sequence[tuple[Hashable, tuple[str, ...] | None]],
    scope: Names,
) -> tuple[str, ...]:
    """Names of arguments and of results in C, in the scope of their function: as they are in Python, where they are
    known; what is `shared` as a whole buffer is called like that."""
    results = ["result"] if written == 1 else [f"result{k + 1}" for k in range(written)]
    known = [*names, *results[max(0, len(names) - read) :]] if len(names) >= read else []
    places = shared or [(k, None) for k in range(read + written)]
    scope.take(*(str(place) for place, own in places if own))
    found = dict[Hashable, str]()
    for name, (place, own) in zip(known or [*(f"in{k}" for k in range(read)), *results], places, strict=True):
        if place not in found:
            found[place] = str(place) if own else scope.allot(identifier(name))
    return tuple(found[place] for place, _ in places)
