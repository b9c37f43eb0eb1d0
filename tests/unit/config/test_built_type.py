"""No thread builds a type that another one uses: msgspec crashes the process then."""

from __future__ import annotations

import json
import subprocess
import sys

from tests.builders.paths import ROOT
from tests.unit.client.test_hostile_messages import STATE

UNBUILT = """
import ast, importlib, json, pathlib, pkgutil
import msgspec, msgspec._utils

import hil, rigctl

names = [found.name for one in (rigctl, hil) for found in pkgutil.walk_packages(one.__path__, one.__name__ + ".")]
modules = [importlib.import_module(name) for name in names if not name.endswith("__main__")]
evaluate, evaluated, unbuilt, seen = msgspec._utils._eval_type, [], [], []

def noted(*given, **named):
    evaluated.append(given)
    return evaluate(*given, **named)

def structs(base):
    for kind in base.__subclasses__():
        yield kind
        yield from structs(kind)

def look(kind, where):
    evaluated.clear()
    msgspec.json.Decoder(kind)
    seen.append(where)
    if evaluated:
        unbuilt.append(where)

def types_in(module):
    '''Types by name that the module decodes or converts to; those that are parameters are Structs or in other calls.'''
    for call in ast.walk(ast.parse(pathlib.Path(module.__file__).read_text())):
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute):
            at = {"convert": 1, "decoded": 1, "decode": 2}.get(call.func.attr)
            given = [one.value for one in call.keywords if one.arg == "type"] + (call.args[at:at + 1] if at else [])
            for kind in given:
                try:
                    yield eval(ast.unparse(kind), vars(module)), f"{module.__name__}: {ast.unparse(kind)}"
                except NameError:
                    pass

msgspec._utils._eval_type = noted
for module in modules:
    for kind, where in types_in(module):
        if not isinstance(kind, int | str):
            look(kind, where)
for kind in structs(msgspec.Struct):
    if kind.__module__.partition(".")[0] in ("rigctl", "hil"):
        look(kind, f"{kind.__module__}: {kind.__name__}")
print(json.dumps([unbuilt, seen]))
"""

AT_ONCE = """
import sys, threading, time
import msgspec._utils

from rigctl.client import shapes

evaluate, payload = msgspec._utils._eval_type, sys.stdin.buffer.read()

def slowly(*given, **named):
    time.sleep(0.002)
    return evaluate(*given, **named)

msgspec._utils._eval_type = slowly
threads = [threading.Thread(target=shapes.state, args=(payload,)) for _ in range(100)]
for thread in threads:
    thread.start()
    time.sleep(0.002)
for thread in threads:
    thread.join()
"""


def test_every_type_that_is_decoded_is_built_where_it_is_defined() -> None:
    found = subprocess.run([sys.executable, "-c", UNBUILT], cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    unbuilt, seen = json.loads(found.stdout)
    assert {"rigctl.ipc.ledger: Standing", "rigctl.client.shapes: _Recorded"} <= {*seen}
    assert unbuilt == [], "decorate with rigctl.config.built_type.built"


def test_threads_read_their_first_state_at_once() -> None:
    """Clients do at their start: one for each stream, one for each query."""
    found = subprocess.run(
        [sys.executable, "-c", AT_ONCE], cwd=ROOT, input=json.dumps(STATE).encode(), capture_output=True, check=False
    )
    assert found.returncode == 0, found.stderr
