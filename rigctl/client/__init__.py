"""The public client of the daemon: ``rigctl.client.connect()``, or ``connect_async()`` on an event loop.

It decodes by the schema that the daemon serves, so it can read a daemon with more fields than this client knows.
"""

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
