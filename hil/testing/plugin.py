"""The pytest plugin: fixtures, options and what a failed test keeps. It loads the rig only for a test that has one."""

from __future__ import annotations

import errno
import pathlib
import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from hil.testing.lockstep_rig import LockstepRig
    from hil.testing.real_time_rig import RealTimeRig
    from hil.testing.stretch import RunStretch

FIXTURES = ("hil_rig", "hil_live_rig")
MARKER = "hil(rig=FILE, change={KEY: VALUE}, timeout_s=SECONDS): rig file, other settings and time limit of the rig"
_DESIGNS = pytest.StashKey[dict[str, Any]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """The ini keys."""
    parser.addini("hil_rig", "rig file of the fixtures hil_rig and hil_live_rig", default="")
    parser.addini(
        "hil_timeout_s",
        "time that a test may take, in seconds: simulated with hil_rig, the computer's with hil_live_rig",
        default="600",
    )
    parser.addini("hil_results", "folder for pictures and recordings of failed tests", default="results/hil")


def pytest_configure(config: pytest.Config) -> None:
    """The marker."""
    config.addinivalue_line("markers", MARKER)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Keep picture and recording of a test that has failed; a lack of memory for its rig is one line."""
    report: Any = yield
    if call.excinfo is not None and (words := _no_room(call.excinfo.value)):
        report.longrepr = words
    if call.when == "call" and report.failed:
        folder = item.config.rootpath / str(item.config.getini("hil_results")) / _name(item.nodeid)
        for fixture in FIXTURES:
            rig: Any = getattr(item, "funcargs", {}).get(fixture)
            if hasattr(rig, "keep"):
                report.sections.append((fixture, _kept(rig, folder, item.name)))
    return report  # type: ignore[no-any-return]


def _no_room(error: BaseException) -> str:
    """What memory a rig needs and what is free, if the test has failed for that; else ""."""
    if not isinstance(error, OSError) or error.errno != errno.ENOSPC:
        return ""
    from rigctl.ipc.runtime_folder import RoomError

    return f"{error.filename}: {error.strerror}" if isinstance(error, RoomError) else ""


def _kept(rig: LockstepRig | RealTimeRig, folder: pathlib.Path, title: str) -> str:
    """What the rig was in, and the files of it that stay."""
    try:
        words = [f"{rig.mode}, fault {rig.fault}, at {rig.time_s:g} s"]
    except RuntimeError as error:  # a daemon that has ended
        words = [str(error)]
    try:
        words += [f"kept: {file}" for file in rig.keep(folder, title)]
    except (OSError, ValueError) as error:
        words.append(f"nothing kept: {error}")
    return "\n".join(words)


@pytest.fixture
def hil_rig(request: pytest.FixtureRequest, tmp_path: pathlib.Path) -> Iterator[LockstepRig]:
    """A rig in simulated time, DISARMED and with every signal fresh."""
    from hil.testing.lockstep_rig import lockstep_rig

    settings, limit_s = _wanted(request)
    with lockstep_rig(settings, _design(request.config, settings), limit_s, tmp_path / "recording") as rig:
        yield rig


@pytest.fixture
def hil_live_rig(request: pytest.FixtureRequest) -> Iterator[RealTimeRig]:
    """Daemon and served rig as processes of their own, in real time, DISARMED."""
    from hil.testing.real_time_rig import real_time_rig

    settings, limit_s = _wanted(request)
    with real_time_rig(settings, limit_s) as rig:
        yield rig


@pytest.fixture
def hil_scenario() -> Callable[[str | pathlib.Path], RunStretch]:
    """Plays a scenario file in simulated time."""
    from hil.testing.lockstep_rig import play_scenario

    return play_scenario


def _wanted(request: pytest.FixtureRequest) -> tuple[Any, float]:
    """Settings and simulated time of a test, by its marker and the ini file."""
    from hil.testing.own_settings import laid_over
    from rigctl.config import rig_file

    config, marker = request.config, request.node.get_closest_marker("hil")
    options = dict(marker.kwargs) if marker is not None else {}
    given = options.pop("rig", None) or config.getini("hil_rig")
    changes, limit = options.pop("change", {}), options.pop("timeout_s", config.getini("hil_timeout_s"))
    if options:
        raise pytest.UsageError(f"marker hil: found {', '.join(options)}, expected rig, change, timeout_s")
    try:
        file = config.rootpath / given if given else rig_file.shipped("paper_rig.yaml")
        return laid_over(file, changes), float(limit)
    except rig_file.ConfigError as error:
        raise pytest.UsageError(str(error)) from None
    except ValueError as error:
        raise pytest.UsageError(f"marker hil: {error}") from None


def _design(config: pytest.Config, settings: Any) -> Any:
    """The design that ``rigctl run`` would use; each rig is designed once in a session."""
    from hil.scenario.play import accepted_design

    known = config.stash.setdefault(_DESIGNS, {})
    key = settings.model_dump_json()
    if key not in known:
        known[key] = accepted_design(settings)
    return known[key]


def _name(nodeid: str) -> str:
    return re.sub(r"[^\w.-]+", "_", nodeid)
