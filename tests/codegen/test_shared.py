from flexhinf.codegen import shared
from flexhinf.codegen.shared import share


def test_made_once_for_each_key():
    made = []
    for key in ("test", 1), ("test", 2), ("test", 1):
        share(key, lambda key=key: made.append(key))
    assert made == [("test", 1), ("test", 2)]


def test_the_least_recently_used_is_forgotten(monkeypatch):
    monkeypatch.setattr(shared, "CAPACITY", 2)
    monkeypatch.setattr(shared, "_kept", type(shared._kept)())
    made = []
    for key in (1, 2, 1, 3, 1, 2):
        share(key, lambda key=key: made.append(key))
    assert made == [1, 2, 3, 2]


def test_what_cannot_be_hashed_is_made_each_time():
    made = []
    for _ in range(2):
        share((["list"],), lambda: made.append(1))
    assert len(made) == 2


def test_code_of_another_level_of_optimisation_is_another_result(monkeypatch):
    made = []
    for level in "0", "3", "0":
        monkeypatch.setenv("FLEXHINF_OPTIMISATION", level)
        share(("test", "level"), lambda level=level: made.append(level))
    assert made == ["0", "3"]
