"""The page of all faults, made of the catalogue: ``python -m rigctl.model.fault_page > docs/fault-list.md``."""

from __future__ import annotations

import re
import sys

from rigctl.model.faults import Fault

_HEAD = """# Faults: what each means, and what to do

Generated from the catalogue of faults (`rigctl/model/faults.py`): `python -m rigctl.model.fault_page >
docs/fault-list.md`; a test holds this file to it. How a fault ends is in [operate.md](operate.md#faults).

| fault | meaning | what the operator does |
|---|---|---|
"""
_COMMAND = re.compile(r"\brigctl [a-z]+(?:-[a-z]+)*(?: MM)?|\b(?:safety|cylinder)\.[a-z_]+")


def document() -> str:
    """The page: a row for each fault, by name."""
    faults = sorted((fault for fault in Fault if fault is not Fault.NONE), key=lambda fault: fault.name)
    return _HEAD + "".join(f"| `{fault.name}` | {fault.meaning} | {marked(fault.remedy)} |\n" for fault in faults)


def marked(words: str) -> str:
    """Words of the catalogue with the commands and keys in them as code."""
    return _COMMAND.sub(lambda found: f"`{found[0]}`", words)


if __name__ == "__main__":
    sys.stdout.write(document())
