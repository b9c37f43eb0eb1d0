"""Files a user names, read and written: an invalid one is refused in one line, and no access waits for ever."""

from __future__ import annotations

import errno
import os
import pathlib
from collections.abc import Callable

import pytest

from hil.cli.files import check_outputs
from hil.scenario.errors import ScenarioError
from rigctl.config import strict_yaml
from rigctl.config.strict_yaml import FileError
from rigctl.ipc import output_file
from rigctl.ipc.output_file import OutputError

ALIASES = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{name}: &{name} [{', '.join([f'*{chr(ord(name) - 1)}'] * 10)}]\n" for name in "bcdefghi"
)


def a_pipe(file: pathlib.Path) -> None:
    os.mkfifo(file)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (a_pipe, "cannot be read: not a file"),  # a pipe without a writer: reading it would wait for ever
        (lambda file: file.symlink_to("/dev/zero"), "cannot be read: not a file"),  # reading it would never end
        (lambda file: file.mkdir(), "cannot be read: Is a directory"),
        (lambda file: file.unlink(missing_ok=True), "cannot be read: No such file or directory"),
        (lambda file: file.symlink_to(file), "cannot be read: Too many levels of symbolic links"),
        (lambda file: file.write_text("k: 1\n" * 100_000), "found more than 200000 bytes"),
        (lambda file: file.write_text("a: [" + "1," * 30_000 + "1]"), ":1: found more than 20000 values"),
        (lambda file: file.write_text(ALIASES), "found more than 20000 values"),
        (lambda file: file.write_text("a: 1\n", encoding="utf-16"), "not UTF-8 text (byte 0)"),
        (lambda file: file.write_bytes(b"a: \x00\n"), "not YAML"),
        (lambda file: file.write_text("[" * 5000), ":1: nested too deeply"),
        (lambda file: file.write_text("a: &a\n  b: *a\n"), "not YAML|refers to itself"),
        (lambda file: file.write_text("a: 1\n---\nb: 2\n"), "not YAML"),
        (lambda file: file.write_text("!!python/object/apply:os.getpid []\n"), "found the tag "),
    ],
)  # fmt: skip
def test_what_is_no_settings_file_is_one_line_that_names_it(
    tmp_path: pathlib.Path, make: Callable[[pathlib.Path], object], said: str
) -> None:
    file = tmp_path / "rig.yaml"
    make(file)
    try:
        document = strict_yaml.read(file)
    except FileError as error:
        assert str(error).startswith(str(file))
        assert any(words in str(error) for words in said.split("|")), str(error)
        assert "\n" not in str(error)
    else:
        pytest.fail(f"read as {document.data!r:.80}")


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_file_of_another_editor_reads_the_same(tmp_path: pathlib.Path, encoding: str, end: str) -> None:
    file = tmp_path / "rig.yaml"
    file.write_bytes(f"# µm{end}a:{end}  b: 1{end}".encode(encoding))
    document = strict_yaml.read(file)
    assert document.data == {"a": {"b": 1}}
    assert document.line_of(("a", "b")) == 3


def test_trying_an_output_leaves_everything_as_it_was(tmp_path: pathlib.Path) -> None:
    kept, link, new = tmp_path / "kept", tmp_path / "link", tmp_path / "new"
    kept.write_text("old")
    link.symlink_to("later")
    for file in (kept, link, new):
        output_file.check("--json", file)
    assert kept.read_text() == "old"
    assert link.is_symlink()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["kept", "link"]


def test_a_pipe_is_not_tried() -> None:
    reading, writing = os.pipe()
    os.set_blocking(reading, False)
    output_file.check("--json", pathlib.Path(f"/dev/fd/{writing}"))
    output_file.write(pathlib.Path(f"/dev/fd/{writing}"), "all of it")
    os.close(writing)
    assert os.read(reading, 100) == b"all of it"
    os.close(reading)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("no/x.json", "there is no folder {folder}/no"),
        ("", "Is a directory"),
        ("file/x.json", "Not a directory"),
        ("x" * 300, "File name too long"),
    ],
)
def test_what_cannot_be_written_is_one_line_that_names_option_and_file(
    tmp_path: pathlib.Path, name: str, said: str
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError) as refused:
        output_file.check("--json", tmp_path / name)
    assert str(refused.value) == f"--json: {tmp_path / name} cannot be written: {said.format(folder=tmp_path)}"


def test_a_disk_that_is_full_is_found_out_when_writing() -> None:
    output_file.check("--json", pathlib.Path("/dev/full"))
    with pytest.raises(OutputError, match=f"^/dev/full cannot be written: {os.strerror(errno.ENOSPC)}$"):
        output_file.write(pathlib.Path("/dev/full"), "x")


def test_an_output_is_neither_an_input_nor_another_output(tmp_path: pathlib.Path) -> None:
    rig, json = tmp_path / "rig.yaml", tmp_path / "x.json"
    rig.write_text("rig: a\n")
    (tmp_path / "same.yaml").symlink_to("rig.yaml")
    check_outputs({"--json": json, "--plot": None}, [rig])
    for outputs in ({"--json": tmp_path / "same.yaml"}, {"--json": json, "--plot": json}):
        with pytest.raises(ScenarioError, match="is in use already"):
            check_outputs(dict(outputs), [rig])
    assert rig.read_text() == "rig: a\n"


def test_commands_refuse_what_is_no_file(tmp_path: pathlib.Path, in_process: Callable[..., object]) -> None:
    pipe = tmp_path / "pipe"
    a_pipe(pipe)
    (tmp_path / "rig.yaml").write_text(f"design: {{gains_file: {pipe}}}\n")
    for words in (("rigctl", "check"), ("rigctl", "tune"), ("rigctl", "demo"), ("hil", "scenario"), ("hil", "paper"),
                  ("hil", "compare"), ("hil", "serve")):  # fmt: skip
        answer = in_process(*words, pipe)
        assert getattr(answer, "returncode") == 2, words  # noqa: B009 - of whatever the fixture returns
        assert f"{pipe}: cannot be read: not a file\n" in getattr(answer, "stderr")  # noqa: B009
