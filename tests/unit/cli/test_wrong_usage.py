"""What is typed wrongly is one line on standard error and exit code 2: no process, no daemon and no file is touched."""

from __future__ import annotations

import shlex

import pytest

from tests.builders.paths import ROOT
from tests.conftest import Command

PAPER = "config/paper_rig.yaml"
NUMBER = "expected a number of newtons such as 290.5"
NO_SUCH = "cannot be read: No such file or directory"

WRONG = [
    # -- which command, which option, how many words
    ("rigctl", "Missing command"),
    ("rigctl fly", "No such command"),
    ("rigctl nonsense", "(see rigctl --help)\n"),
    ("rigctl --bad", "(see rigctl --help)\n"),
    ("rigctl status --bad", "(see rigctl status --help)\n"),
    ("rigctl --key a tare --bad", "(see rigctl tare --help)\n"),
    ("rigctl bench", "(see rigctl bench --help)\n"),
    ("rigctl arm --bogus", "No such option"),
    ("rigctl target", "Missing argument"),
    ("rigctl target 1 2", "unexpected extra argument"),
    ("rigctl tare 5", "5"),
    ("hil", "Missing command"),
    ("hil nonsense", "(see python -m hil --help)\n"),
    ("hil faults --bad", "(see python -m hil faults --help)\n"),
    ("hil new rig", "(see python -m hil new --help)\n"),
    *(
        (f"rigctl {command}", ": 'foo' is not one of '")
        for command in ("lease foo", "keys foo", "audit foo", "bridge foo", "export x --to foo -o y")
    ),
    # -- an option without a value: a script's variable that was never set must not choose the default rig
    *(
        (f"rigctl {verb} {option} {value}", f"'{option}': found nothing, expected a value")
        for verb, option, value in (
            *(("hold", option, value) for option in ("--connect", "--rig", "--operator") for value in ("''", "' '")),
            *((verb, option, "''") for verb in ("status", "watch") for option in ("--connect", "--rig")),
        )
    ),
    # -- numbers: one reader, with an example in each refusal
    ("rigctl target abc", "found 'abc', expected a number of newtons"),
    ("rigctl target nan", "found 'nan', expected a number of newtons"),
    ("rigctl target inf", "found 'inf', expected a number of newtons"),
    ("rigctl target 290,5", "found '290,5', expected a number of newtons with a decimal point, such as 290.5"),
    ("rigctl target 3_00", f"found '3_00', {NUMBER}"),
    ("rigctl target \uff12\uff19\uff10", NUMBER),
    ("rigctl target \u2212290", NUMBER),
    ("rigctl carry 1,5", "found '1,5', expected a number of seconds with a decimal point, such as 290.5"),
    ("rigctl release 10,5", "found '10,5', expected a number of millimetres with a decimal point, such as 290.5"),
    ("rigctl confirm-stroke 4_0", "found '4_0', expected a number of millimetres such as 290.5"),
    ("rigctl move 1,5", "found '1,5', expected a whole number of moves such as 3"),
    ("rigctl move 1.5", "found '1.5', expected a whole number of moves such as 3"),
    ("rigctl move \uff13", "expected a whole number of moves such as 3"),
    ("rigctl alarms shelve X --reason r --for 0,5", "expected a number of minutes with a decimal"),
    ("rigctl alarms shelve X --reason r --for 481", "found 481, expected 0.1 to 480 minutes"),
    ("rigctl audit show --last 3,5", "'--last': found '3,5', expected a whole number of entries such as 3"),
    ("rigctl audit show --last 1_0", "'--last': found '1_0', expected a whole number of entries such as 3"),
    ("rigctl audit show --last 0", "'--last': found 0, expected at least 1 entries"),
    (f"rigctl audit show --last {'9' * 30}", "expected a whole number of entries such as 3"),
    (f"rigctl bench {PAPER} --rate 1_000", "found '1_000', expected a whole number of hertz"),
    (f"rigctl bench {PAPER} --rate 333", "--rate: found 333"),
    (f"rigctl bench {PAPER} --rate 0", "--rate: found 0"),
    (f"rigctl bench {PAPER} --rate 1000 --rate 8000", "--rate: found 8000"),
    (f"rigctl bench {PAPER} --seconds 1,5", "expected a number of seconds with a decimal point"),
    (f"rigctl bench {PAPER} --seconds 0", "'--seconds': found 0, expected 1 to 3600 seconds"),
    (f"rigctl bench {PAPER} --seconds nan", "'--seconds': found 'nan', expected a number of seconds"),
    ("rigctl bridge foxglove --rate 0,5", "expected a number of hertz with a decimal point"),
    ("rigctl bridge foxglove --rate 0", "--rate"),
    ("rigctl keys add kim --days 3_0", "found '3_0', expected a whole number of days such as 3"),
    ("rigctl calibrate --weight-n 98,1", "expected a number of newtons with a decimal point"),
    ("rigctl calibrate --weight-n much", "much"),
    (f"rigctl tune {PAPER} --seed 1_0", "'--seed': found '1_0', expected a whole number such as"),
    # -- rig, endpoint and what a command is about
    ("rigctl status --connect nonsense", "found endpoint 'nonsense', expected e.g. tcp/127.0.0.1:7447"),
    ("rigctl status --rig 'No Such'", "found rig 'No Such', expected a rig's name"),
    ("rigctl doctor --connect 'x y'", "endpoint"),
    ("rigctl lease steal", "'steal' is not one of 'show', 'take', 'return'"),
    ("rigctl lease return --reason x", "found --reason, expected with take alone"),
    ("rigctl lease take --reason", "requires an argument"),
    ("rigctl identify --in space", "expected hold or tension"),
    ("rigctl identify --file nowhere/x.json", "a folder that is there"),
    ("rigctl identify --plot x.png", "--plot without --response"),
    ("rigctl identify --response --in tension", "expected hold or compensating"),
    ("rigctl identify --response --plot x.txt", "a name ending in .png, .svg, .pdf"),
    ("rigctl identify --response --plot nowhere/x.png", "nowhere"),
    ("rigctl calibrate --shunt --adopt", "expected --shunt alone"),
    ("rigctl bridge plotjuggler", "expected --layout FILE"),
    ("rigctl bridge foxglove --listen nowhere", "--listen: found 'nowhere'"),
    ("rigctl bridge excel", "excel"),
    ("rigctl audit", "verify|show"),
    ("rigctl audit count", "count"),
    ("rigctl audit verify README.md --head abc", "--head: found 'abc', expected 64 letters 0-9 a-f"),
    ("rigctl audit verify README.md --last 3", "found a choice of entries, expected with show alone"),
    (f"rigctl audit show README.md --head {'0' * 64}", "found --head, expected with verify alone"),
    ("rigctl audit show README.md --since yesterday", "--since: found 'yesterday', expected ISO 8601"),
    (f"rigctl tune {PAPER} --auto --optimize", "--auto: expected without --from and --optimize"),
    (f"rigctl tune {PAPER} --every-spring", "--every-spring: expected with --from and --gains"),
    # -- files to read
    ("rigctl run", "FILE"),
    ("rigctl run nothing.yaml", "nothing.yaml: cannot be read"),
    ("rigctl check README.md", "README.md:"),
    ("rigctl doctor none.yaml", "none.yaml"),
    ("rigctl demo config/rig.yaml", "demo: found nothing"),
    ("rigctl bench config/rig.yaml", "simulation: found nothing"),
    ("rigctl bridge foxglove no-such-rig.yaml", "no-such-rig.yaml"),
    ("rigctl audit verify nothing.jsonl", f"nothing.jsonl {NO_SUCH}"),
    ("rigctl audit verify tests", "tests cannot be read: Is a directory"),
    ("rigctl audit verify /dev/zero", "/dev/zero cannot be read: not a file"),
    ("rigctl audit verify nothing.yaml", "nothing.yaml: cannot be read"),
    ("rigctl tune nothing.yaml", "nothing.yaml: cannot be read"),
    ("rigctl tune config", "config: cannot be read: Is a directory"),
    ("rigctl tune README.md", "README.md:"),
    (f"rigctl tune {PAPER} --from nothing.json", "--from: nothing.json is no file, expected the rig's ledger"),
    (f"rigctl tune {PAPER} --from README.md", "README.md: no calibration ledger"),
    ("rigctl info none.mcap", "none.mcap cannot be read: no such file"),
    ("rigctl info README.md", "README.md: not an MCAP file"),
    ("rigctl export README.md --to csv -o none.csv", "README.md: not an MCAP file"),
    ("rigctl report none.mcap", "none.mcap cannot be read: no such file"),
    ("rigctl report README.md", "README.md: not an MCAP file"),
    ("rigctl report tests", "tests cannot be read: not a file"),
    ("hil serve", "Missing argument 'file'"),
    ("hil serve /nowhere.yaml", "/nowhere.yaml"),
    ("hil serve --x y", "--x"),
    *((f"hil {study} missing.yaml", "missing.yaml: cannot be read") for study in ("compare", "paper")),
    *((f"hil {study} config/rig.yaml", "simulation: found nothing") for study in ("compare", "paper")),
    *((f"hil {study} --depth 3", "No such option") for study in ("compare", "paper")),
    ("hil compare --only nothing", "--only: found 'nothing', expected paper_k6"),
    ("hil compare --controllers pi,bang", "--controllers: found 'bang', expected passive, p,"),
    ("hil compare --bound --only jolts", "--only: found 'jolts', expected paper_k6"),
    ("hil compare --bound --controllers pi", "--controllers: found 'pi', expected ours"),
    ("hil compare --shares missing/shares.json", "--shares: missing/shares.json cannot be written"),
    # -- files to write
    ("rigctl demo --json nowhere/x.json", "no folder"),
    (f"rigctl tune {PAPER} --json nowhere/x.json", "--json: nowhere/x.json cannot be written: there is no folder"),
    (f"rigctl tune {PAPER} --json config", "--json: config cannot be written: Is a directory"),
    (f"rigctl tune {PAPER} --json {PAPER}", "expected a file for the figures"),
    (f"rigctl tune {PAPER} --plot x.jpg", "expected a name ending in .png, .svg, .pdf"),
    (f"rigctl tune {PAPER} --plot /proc/x.png", "--plot: /proc/x.png cannot be written: No such file"),
    (f"rigctl tune {PAPER} --gains config/rig.yaml", "is there and is no gain file"),
    (f"rigctl tune {PAPER} --gains /dev/null", "is there and is no gain file"),
    (f"rigctl tune {PAPER} --gains /proc/g.yaml", "--gains: /proc/g.yaml cannot be written: "),
    *(
        (f"hil {study} --json missing/rows.json", "--json: missing/rows.json cannot be written")
        for study in ("compare", "paper")
    ),
    *((f"hil {study} --plots README.md", "--plots: README.md cannot be made") for study in ("compare", "paper")),
]
"""What is typed, and words of the line that says what is wrong with it."""


@pytest.mark.parametrize(("typed", "words"), WRONG, ids=[typed for typed, _ in WRONG])
def test_wrong_usage_is_one_line_and_exit_code_2(in_process: Command, typed: str, words: str) -> None:
    before = [(ROOT / file).read_bytes() for file in ("config/rig.yaml", PAPER)]
    answer = in_process(*shlex.split(typed))
    assert (answer.returncode, answer.stdout) == (2, "")
    assert words in answer.stderr
    assert answer.stderr.count("\n") == 1
    assert "Value error" not in answer.stderr
    assert before == [(ROOT / file).read_bytes() for file in ("config/rig.yaml", PAPER)]
