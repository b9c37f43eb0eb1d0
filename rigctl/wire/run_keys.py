"""The keys of one run of the daemon, in its run-time folder.

| file | what | read by |
|---|---|---|
| ``gateway_key.json`` | the key that signs what the daemon says | the gateway, which makes all three |
| ``operator_key.json`` | the key that proves an operator's command | operators: the daemon's user |
| ``public_key.json`` | the key that the daemon's signatures are verified with | everyone who may enter the folder |

Of the installed service, the group ``rigctl-operator`` reads the operator key too. Each key belongs to one run: another
``run_id`` means that another daemon made it.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from rigctl.config.built_type import built

GATEWAY_KEY, OPERATOR_KEY, PUBLIC_KEY = "gateway_key.json", "operator_key.json", "public_key.json"
_Key = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]


@built
class KeyFile(msgspec.Struct):
    """One of the three files; ``key``: 32 bytes as hexadecimal text."""

    rig: str
    listen: str
    run_id: str
    key: _Key

    @property
    def secret(self) -> bytes:
        """The key's bytes."""
        return bytes.fromhex(self.key)
