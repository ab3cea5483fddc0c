"""Lines of exported C: none is too long, and words of a comment flow."""

from __future__ import annotations

from flexhinf.codegen.c import folded
from flexhinf.codegen.c.layout import WIDTH


def test_words_of_a_comment_flow_into_its_next_line() -> None:
    words = [f"word{k}" for k in range(60)]
    first, second = " ".join(words[:30]), " ".join(words[30:])
    lines = folded(f"int a;\n/* {first}\n * {second} */\nint b;").split("\n")
    assert max(map(len, lines)) <= WIDTH
    assert (lines[0], lines[-1]) == ("int a;", "int b;")
    assert " ".join(line.strip(" */") for line in lines[1:-1]).split() == words
    assert min(map(len, lines[1:-2])) > WIDTH - len(" word59")


def test_strings_are_not_cut_and_comments_of_both_kinds_are() -> None:
    text = '"' + "one, two and " * 12 + '"'
    assert folded(f"say(first, {text});").split("\n") == ["say(first,", f"        {text});"]
    words = "one, two and " * 12 + "three"
    for head, tail in (("// ", ""), ("/* ", " */")):
        lines = folded(f"    {head}{words}{tail}").split("\n")
        assert max(map(len, lines)) <= WIDTH
        assert " ".join(line.strip(" /*") for line in lines) == words
        assert folded(f"    int a; {head}{words}{tail}").split("\n") == [*lines, "    int a;"]


def test_no_line_has_the_end_of_a_comment_alone() -> None:
    text = "/* " + "a" * 58 + " " + "b" * 57 + " */"
    assert folded(text).split("\n") == ["/* " + "a" * 58, " * " + "b" * 57 + " */"]


def test_a_word_that_is_longer_than_a_line_stands_whole() -> None:
    word = "j" * 130
    assert word in folded(f"/* {word} joint */")
