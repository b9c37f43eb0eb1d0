"""Findings of ``rigctl doctor`` on the rig's keys: whether the gateway can listen, and which keys end soon."""

from __future__ import annotations

import datetime

from rigctl.cli.doctor_host import DoctorFinding, fails, good, warning
from rigctl.cli.keys import SOON
from rigctl.config.settings import RigSettings
from rigctl.config.telemetry_section import open_listen
from rigctl.identity.key_folder import KeyFolder, KeyFolderError


def reach(settings: RigSettings, now: datetime.datetime) -> list[DoctorFinding]:
    """Who reaches the daemon, and by which keys."""
    name = "reach"
    if settings.key_folder is None:
        reached = open_listen(settings.telemetry)
        if reached:
            return [warning(name, f"{reached}, waived: {settings.telemetry.listen_waiver}", "certificates")]
        return [good(name, "this computer alone")]
    folder = KeyFolder(settings.key_folder)
    try:
        folder.check_gateway(now)
        valid = [one for one in folder.certificates() if one.is_valid(now)]
        until = folder.gateway_credentials().not_after
    except KeyFolderError as error:
        return [fails(name, str(error), "a key folder", "rigctl keys --help")]
    last = {one.name: one.not_after for one in valid}  # the newest of a name is the last of its name
    last |= {"gateway": until}
    if early := [one.name for one in valid if one.not_before > now]:
        found = f"keys are not yet valid by this computer's clock, which reads {now:%Y-%m-%d}: {', '.join(early)}"
        return [warning(name, found, "keys that are valid", "set the clock")]
    ending = [holder for holder, end in last.items() if end - now < SOON]
    if ending:
        found = f"keys end within {SOON.days} days: {', '.join(ending)}"
        return [warning(name, found, "keys that last", f"rigctl keys renew {ending[0]}")]
    return [good(name, f"with certificates, {len(last) - 1} people")]
