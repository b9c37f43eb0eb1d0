"""The reason why a scenario is not played, or not to its end."""

from __future__ import annotations


class ScenarioError(ValueError):
    """``str()`` is one line per finding with place and reason; ``exit_code`` 2 for input, 1 for the rig."""

    def __init__(self, findings: list[str], exit_code: int = 2) -> None:
        super().__init__("\n".join(findings))
        self.findings = findings
        self.exit_code = exit_code
