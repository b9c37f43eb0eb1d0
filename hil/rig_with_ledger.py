"""A rig in lockstep with its ledger: tare, calibration, identification and gains, from command to what is in force."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.lockstep import Lockstep
from rigctl.commission.identification import IdentificationError
from rigctl.commission.load_record import bins_of
from rigctl.control.excitation.trials import LoadBin
from rigctl.control.law.tension import Gains
from rigctl.ipc import ledger
from rigctl.ipc.ledger import Entry
from rigctl.model.requests import Request
from rigctl.model.verbs import Refusal
from rigctl.operations import calibration_findings as findings
from rigctl.operations import evaluation, filing, gain_admission
from rigctl.operations.calibration_findings import Measured
from rigctl.operations.evaluation import EvaluationError
from rigctl.operations.filing import Filed

BEGAN_NS = 1_767_225_600_000_000_000
"""Wall clock at the begin of simulated time by default: 2026-01-01."""
LONGEST_S, PART_S = 120.0, 0.5


class GivenTrial(NamedTuple):
    """A trial that has been given and is not answered yet."""

    request: Request
    number: int


class RigWithLedger:
    """A `RigInOperation`. The ledger is in memory; calculations are made at once, while simulated time is at rest."""

    def __init__(
        self, rig: Lockstep, gains: Gains, design: Mapping[str, Any] | None = None, began_ns: int = BEGAN_NS
    ) -> None:
        """``gains``: of the loop. ``design``: in force, as in ``active.json``; GAINS needs it."""
        self.settings = rig.settings
        self.design: Mapping[str, Any] = design or {}
        self._rig, self._gains, self._began_ns = rig, gains, began_ns
        self._entries: list[Entry] = []
        self._records = rig.runtime.records.reader()
        self._kept = [self._records.read()]
        self.standing = ledger.standing(self.settings, (), self.wall_ns)

    @property
    def wall_ns(self) -> int:
        """The wall clock, which runs with simulated time."""
        return self._began_ns + self._rig.clock.now()

    def carry_out(self, request: Request) -> Filed:
        """Carry out a command whose result is put on record, as the daemon does.

        Returns:
            The finding, on record and in force in the loop, or the reason why there is none.

        Raises:
            TimeoutError: the loop has not answered.
        """
        if (why := findings.impossible(self.settings, request)) is not None:
            return Filed(reason="not_possible", text=why)
        return self.finish(self.begin(request))

    def begin(self, request: Request) -> GivenTrial:
        """Give the command; until `finish` the caller lets time pass as the trial needs it, for 4 s at most."""
        self._kept = [self._records.read()]
        return GivenTrial(request, self._rig.give(request.verb, *request.numbers))

    def finish(self, trial: GivenTrial) -> Filed:
        """Let time pass until the trial is answered, and put on record and in force what it found."""
        request, reply = trial.request, self._reply_to(trial)
        if (refusal := Refusal(int(reply["reason"]))) is not Refusal.NONE:
            return _refused(request, refusal)
        filed = filing.file(self, request, Measured.of(reply, self.wall_ns), int(reply["t_ns"]))
        finding = filed.finding
        if finding is None:
            return filed
        if finding.order is not None:
            refusal = self._rig.command(finding.order.setting, *finding.order.values)
            if refusal is not Refusal.NONE:
                self.standing = filing.withdraw(self, finding.entry, self.wall_ns) or self.standing
                return _refused(request, refusal)
        self.standing = filed.standing or self.standing
        if filed.design is not None:
            self.design, self._gains = filed.design, Gains(**filed.design["gains"])
        return filed

    def _reply_to(self, trial: GivenTrial) -> Any:
        rate_hz = self.settings.loop.rate_hz
        for _ in range(round(LONGEST_S / PART_S)):
            for _ in range(round(PART_S * rate_hz)):
                self._rig.tick()
            self._kept.append(self._records.read())
            if (reply := self._rig.reply_to(trial.number)) is not None:
                return reply
        raise TimeoutError(f"{trial.request.verb.name} was not answered within {LONGEST_S:g} s")

    # -- RigInOperation -----------------------------------------------------------------------------------------
    def entries(self) -> list[Entry]:
        """Every entry, oldest first."""
        return list(self._entries)

    def append(self, written: Entry) -> list[Entry]:
        """File one more entry; returns all."""
        self._entries.append(written)
        return self.entries()

    def load_bins(self, until_ns: int) -> list[LoadBin]:
        """Parts of the record of a load's step, from the ring of events."""
        events = self._rig.runtime.events.reader(from_start=True).read()
        return bins_of(events[events["t_ns"] <= until_ns])

    def records(self, after_ns: int, until_ns: int) -> npt.NDArray[Any]:
        """Records since the trial was given."""
        records = np.concatenate(self._kept)
        return records[(records["t_ns"] <= until_ns) & (records["t_ns"] > after_ns)]

    excited = records

    def response(self, records: npt.NDArray[Any]) -> dict[str, Any]:
        """See `rigctl.operations.evaluation.response`."""
        try:
            return evaluation.response(self.settings, self._gains, records)
        except IdentificationError as error:
            raise EvaluationError(str(error)) from None

    def admitted(self, text: str, name: str) -> dict[str, Any]:
        """See `rigctl.operations.gain_admission.admitted`."""
        return gain_admission.admitted(self.settings, text, name)


def _refused(request: Request, refusal: Refusal) -> Filed:
    return Filed(reason=refusal.name.lower(), text=f"{request.verb.name} was refused: {refusal.name}")
