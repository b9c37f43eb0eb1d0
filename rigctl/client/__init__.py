"""The public client of the daemon: ``rigctl.client.connect()``, or ``connect_async()`` on an event loop.

It decodes by the schema that the daemon serves, so it can read a daemon with more fields than this client knows.
A name is loaded when it is first used: ``rigctl hold`` needs one small module of this folder and no Zenoh.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rigctl.client.block_order import Count
    from rigctl.client.connection import ChoiceError, NoDaemonError, rigs
    from rigctl.client.decoding import SampleField, SchemaError
    from rigctl.client.rig import Rig, connect
    from rigctl.client.rig_async import AsyncRig, connect_async
    from rigctl.client.samples import Samples
    from rigctl.client.stream import Stream
    from rigctl.client.stream_async import AsyncSamples, AsyncStream

__all__ = [
    "AsyncRig",
    "AsyncSamples",
    "AsyncStream",
    "ChoiceError",
    "Count",
    "NoDaemonError",
    "Rig",
    "SampleField",
    "Samples",
    "SchemaError",
    "Stream",
    "connect",
    "connect_async",
    "rigs",
]

_MODULES = {
    "block_order": ("Count",),
    "connection": ("ChoiceError", "NoDaemonError", "rigs"),
    "decoding": ("SampleField", "SchemaError"),
    "rig": ("Rig", "connect"),
    "rig_async": ("AsyncRig", "connect_async"),
    "samples": ("Samples",),
    "stream": ("Stream",),
    "stream_async": ("AsyncSamples", "AsyncStream"),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> Any:
    if (module := _MODULE_OF.get(name)) is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found = globals()[name] = getattr(importlib.import_module(f"{__name__}.{module}"), name)
    return found


def __dir__() -> list[str]:
    return __all__
