"""The names that users rely on: none of those of the last release is renamed or removed."""

from tests.golden.names import names, read


def test_every_name_of_the_last_release_is_in_the_code() -> None:
    """New names join the file with a release: `python -m tests.golden.names`."""
    missing = sorted(set(read()) - set(names()))
    assert not missing, f"renamed or removed: {missing}; restore the names, or raise the major version"


def test_the_file_has_every_kind_of_name() -> None:
    assert {kind for kind, _ in names()} == {kind for kind, _ in read()}
    assert ("exit code", "2 bad input") in read()
    assert ("python", "meanflock.Controller.step(received)") in read()
    assert ("option", "run --method") in read()
