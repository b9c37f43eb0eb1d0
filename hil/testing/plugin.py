"""The pytest plugin: fixtures, options and what a failed test keeps. It loads the rig only for a test that has one."""

from __future__ import annotations

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
MARKER = "hil(rig=FILE, change={KEY: VALUE}, timeout_s=SECONDS): rig file, other settings and time limit of hil_rig"
_DESIGNS = pytest.StashKey[dict[str, Any]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """The ini keys."""
    parser.addini("hil_rig", "rig file of the fixtures hil_rig and hil_live_rig", default="")
    parser.addini("hil_timeout_s", "simulated time that a test with hil_rig may take, in seconds", default="600")
    parser.addini("hil_results", "folder for pictures and recordings of failed tests", default="results/hil")


def pytest_configure(config: pytest.Config) -> None:
    """The marker."""
    config.addinivalue_line("markers", MARKER)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Iterator[None]:
    """Keep picture and recording of a test that has failed."""
    report: Any = yield
    rig = getattr(item, "funcargs", {}).get("hil_rig") if call.when == "call" and report.failed else None
    if rig is not None and hasattr(rig, "keep"):
        folder = item.config.rootpath / str(item.config.getini("hil_results")) / _name(item.nodeid)
        try:
            words = "\n".join(f"kept: {file}" for file in rig.keep(folder, item.name))
        except (OSError, ValueError) as error:
            words = f"nothing kept: {error}"
        report.sections.append(("hil_rig", f"{rig.mode}, fault {rig.fault}, at {rig.time_s:g} s\n{words}"))
    return report  # type: ignore[no-any-return]


@pytest.fixture
def hil_rig(request: pytest.FixtureRequest, tmp_path: pathlib.Path) -> Iterator[LockstepRig]:
    """A rig in simulated time, DISARMED and with every signal fresh."""
    from hil.testing.lockstep_rig import lockstep_rig

    settings, limit_s = _wanted(request)
    with lockstep_rig(settings, _gains(request.config, settings), limit_s, tmp_path / "recording") as rig:
        yield rig


@pytest.fixture
def hil_live_rig(request: pytest.FixtureRequest) -> Iterator[RealTimeRig]:
    """Daemon and served rig as processes of their own, in real time, DISARMED."""
    from hil.testing.real_time_rig import real_time_rig

    settings, _ = _wanted(request)
    with real_time_rig(settings) as rig:
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


def _gains(config: pytest.Config, settings: Any) -> Any:
    """The gains that ``rigctl run`` would use; each rig is designed once in a session."""
    from hil.scenario.play import design

    known = config.stash.setdefault(_DESIGNS, {})
    key = settings.model_dump_json()
    if key not in known:
        known[key] = design(settings)
    return known[key]


def _name(nodeid: str) -> str:
    return re.sub(r"[^\w.-]+", "_", nodeid)
