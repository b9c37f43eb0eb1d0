from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rigctl.config.rig_file import load
from rigctl.config.settings import RigSettings
from tests.builders.paths import ROOT

CONFIG = ROOT / "config"
Rig = Callable[..., RigSettings]


@pytest.fixture(scope="session")
def rig() -> Rig:
    """The paper's rig with some values changed: ``rig(plant={"spring_n_mm": 13.0}, ...)``."""
    paper = load(CONFIG / "paper_rig.yaml")

    def changed(**sections: dict[str, Any]) -> RigSettings:
        return paper.model_copy(
            update={name: getattr(paper, name).model_copy(update=values) for name, values in sections.items()}
        )

    return changed
