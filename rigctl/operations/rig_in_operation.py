"""What an operation needs of a rig: the gateway has it over the rings, a rig in lockstep has it at hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy.typing as npt

from rigctl.config.settings import RigSettings
from rigctl.control.excitation.trials import LoadBin
from rigctl.ipc.ledger import Entry, Standing


class CellInOperation(Protocol):
    """The ledger of a rig, and what is recorded of its cell."""

    @property
    def settings(self) -> RigSettings:
        """Of the rig file."""

    @property
    def standing(self) -> Standing:
        """The values of the ledger that are in force."""

    def entries(self) -> list[Entry]:
        """Every entry of the ledger, oldest first.

        Raises:
            LedgerError: they cannot be read or believed.
        """

    def append(self, written: Entry) -> list[Entry]:
        """File one more entry; returns all.

        Raises:
            LedgerError: it could not be written; the ledger is unchanged.
        """

    def load_bins(self, until_ns: int) -> Sequence[LoadBin]:
        """Parts of the record of a load's step that ended at ``until_ns``, from the last one before the step on."""


class RigInOperation(CellInOperation, Protocol):
    """A rig whose loop runs. Times are those of its records, ns."""

    @property
    def design(self) -> Mapping[str, Any]:
        """The design in force, as in ``active.json``."""

    def records(self, after_ns: int, until_ns: int) -> npt.NDArray[Any]:
        """Records of the ticks after ``after_ns`` up to ``until_ns``."""

    def excited(self, after_ns: int, until_ns: int) -> npt.NDArray[Any]:
        """As `records`, of an excitation that lasted longer than these are kept."""

    def response(self, records: npt.NDArray[Any]) -> dict[str, Any]:
        """As `rigctl.operations.evaluation.response`, by the gains in force.

        Raises:
            EvaluationError: the records cannot be evaluated.
        """

    def admitted(self, text: str, name: str) -> dict[str, Any]:
        """As `rigctl.operations.gain_admission.admitted`.

        Raises:
            NotAdmittedError: the gains are refused.
        """
