"""``rigctl hold`` where `rigctl.cli.quick_hold` finds no daemon on this computer: over the network."""

from __future__ import annotations

from rigctl.cli.options import Connect, Json, Operator, Rig
from rigctl.cli.verbs import give_and_end
from rigctl.model.verbs import Verb


def hold(json: Json = False, connect: Connect = None, rig: Rig = None, operator: Operator = None) -> None:
    """Stop and hold the stroke where it is. Anyone may, always: it needs no lease and takes none.

    To a daemon of this computer and user it goes past the network, as a datagram to a socket of the loop
    (FOLDER/hold.UID in memory), and works while every other process hangs or is gone; to any other as every command.
    """
    give_and_end(Verb.HOLD, json, connect, rig, operator)
