"""The public client of the daemon: ``rigctl.client.connect()``, or ``connect_async()`` on an event loop.

It decodes by the schema that the daemon serves, so it can read a daemon with more fields than this client knows.
"""

from rigctl.client.connection import ChoiceError, NoDaemonError, rigs
from rigctl.client.decoding import Field, SchemaError
from rigctl.client.ordering import Count
from rigctl.client.rig import Rig, Samples, connect
from rigctl.client.rig_async import AsyncRig, AsyncSamples, connect_async
from rigctl.client.stream import Stream
from rigctl.client.stream_async import AsyncStream

__all__ = [
    "AsyncRig",
    "AsyncSamples",
    "AsyncStream",
    "ChoiceError",
    "Count",
    "Field",
    "NoDaemonError",
    "Rig",
    "Samples",
    "SchemaError",
    "Stream",
    "connect",
    "connect_async",
    "rigs",
]
