"""The running daemon's folder in memory: rings, the resolved configuration, and the lock against a second daemon.

``/dev/shm/rigctl-<rig>/``: ``records events frames commands holds replies notes desk supervision`` (rings),
``hold.*`` (the loop's sockets for HOLD of this computer's users), ``active.json`` (settings, version, design),
``recorder.json`` (files written by the recorder), ``control.json`` (settings read back by the control process),
``calibration.json`` (the cell's zero, scale and due date in force), ``design.json`` (gains exchanged during the run, in
place of the design in ``active.json``), ``stroke.json`` (the last known stroke at the start of the control process),
``lease.json`` (holder of the lease), ``gateway.*`` and ``command.sock`` (the gateway's own), ``waits.json`` (what the
start of the control process waits for), ``public.slot`` (`rigctl.ipc.public_slot`), ``lock`` (held by the supervisor,
with its pid in it), ``end.*`` (a process that is a service of its own is to end).

Anyone may make a folder of this name in ``/dev/shm``. A daemon uses only a folder that its user owns, follows no link
in it, and makes its files anew (0600). Others may enter it but neither list nor write to it (0711): they find the
daemon by ``public.json`` and ``lock``, read ``public.slot``, and give it HOLD. Its processes open every file relative
to a descriptor of the folder that each of them has checked (`Runtime.entered`).

The installed service has its folders in ``/run/rigctl``, which belongs to the supervisor's user. There the folder's
group lists it (0751) and reads rings and files (0640), the groups ``rigctl-operator`` and ``rigctl-viewer`` open
``gateway.sock`` and ``command.sock``, and what another process than supervisor and loop writes is in a folder or of a
group of its own (`rigctl.ipc.writers`).

What reads only the small files uses `rigctl.ipc.folder_files`, which loads no numpy.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import pathlib
import shutil
import stat
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import msgspec

from rigctl.config import layout
from rigctl.ipc import access_list, record, whole_file, writers
from rigctl.ipc.folder_files import DESIGN, RECORDED, REFUSED, WAITS, FolderFiles
from rigctl.ipc.folder_places import ACTIVE, GATEWAY_SOCKET, LOCK, LONGEST_LOCK, daemon_pid, digest
from rigctl.ipc.ring import RingReader, RingWriter, create, identity

if TYPE_CHECKING:
    from rigctl.config.settings import RigSettings  # slow: the public client reads folders too

__all__ = [
    "ACTIVE",
    "BASE",
    "DESIGN",
    "PUBLIC_MODE",
    "RECORDED",
    "REFUSED",
    "WAITS",
    "AlreadyRunningError",
    "FolderError",
    "RingFile",
    "RoomError",
    "Runtime",
    "daemon_pid",
    "daemons",
    "frames_held",
    "is_free",
    "recorded",
]

BASE = layout.SHARED_MEMORY
"""Parent of the folders of the daemons that users start on this computer; anyone may make a folder there."""
PUBLIC_MODE = 0o644
"""Mode of a file that everyone who may enter the folder may read."""
_MORE = " (a container: start it with a larger --shm-size, Docker's default is 64 MB)"
_SMALL_RING = 4096
_FEW = 16  # of a ring whose newest slot alone is read
_NOTES = 1024
_SHORTEST_FRAME_BITS = 47  # 11-bit identifier, no data, no stuffing, the gap to the next frame
_FASTEST_BIT_S = 1_000_000
_DESCRIPTORS = pathlib.Path("/proc/self/fd")
_END = "end."
_FOLDER_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


class FolderError(RuntimeError):
    """The runtime folder cannot be used; ``str()`` is one line."""


class AlreadyRunningError(RuntimeError):
    """Another daemon holds this rig."""


class RoomError(OSError):
    """The memory of the rings is not free; ``strerror`` states what they need and what is free."""


def frames_held(settings: RigSettings, history_s: int) -> int:
    """Frames a fully loaded bus carries in ``history_s``."""
    rate_hz = (settings.can.bitrate_bit_s or _FASTEST_BIT_S) // _SHORTEST_FRAME_BITS
    return rate_hz * history_s


def recorded() -> list[dict[str, Any]]:
    """recorder.json of every daemon that runs on this computer."""
    found = []
    for folder in [one for base in (layout.RUN, BASE) for one in sorted(base.glob("rigctl-*"))]:
        with contextlib.suppress(OSError, msgspec.MsgspecError):  # another user's, or just being deleted
            runtime = Runtime(folder)
            runs = pathlib.Path(f"/proc/{runtime.read_json(ACTIVE).get('pid', 0)}").exists()
            if runs and (content := runtime.read_json(RECORDED)):
                found.append(content)
    return found


def daemons(*bases: pathlib.Path) -> list[tuple[str, int]]:
    """Rig and pid of every daemon that runs on this computer, by the pid in its lock; ``bases``: other than all."""
    folders = [folder for base in bases or (layout.RUN, BASE) for folder in sorted(base.glob("rigctl-*"))]
    return [(folder.name.removeprefix("rigctl-"), pid) for folder in folders if (pid := daemon_pid(folder))]


def is_free(rig: str, base: pathlib.Path = BASE) -> bool:
    """Whether this user could start a daemon of this name: none runs, and no other user owns the folder."""
    try:
        found = (base / f"rigctl-{rig}").lstat()
    except OSError:
        return True
    own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid()
    return own and rig not in dict(daemons(base))


@dataclass(frozen=True)
class RingFile:
    """A ring of the folder."""

    path: pathlib.Path
    slot: record.Slot

    def reader(self, *, from_start: bool = False) -> RingReader:
        """Reads slots written from now on; ``from_start``: from the oldest one still held."""
        return RingReader(self.path, self.slot.dtype, from_start=from_start)

    def writer(self) -> RingWriter:
        """For the one process that writes this ring, see docs/architecture.md."""
        return RingWriter(self.path, self.slot.layout)


class Runtime(FolderFiles):
    """One rig's rings and files; every process of the daemon opens what it needs."""

    def __init__(self, directory: str | pathlib.Path, *, shared: bool | None = None) -> None:
        """``shared``: whether it is the installed service's, which its place shows otherwise."""
        super().__init__(directory, shared=shared)
        self.records = self._ring("records", record.RECORD)
        self.frames = self._ring("frames", record.FRAME)
        self.events = self._ring("events", record.EVENT)
        self.replies = self._ring("replies", record.REPLY)
        self.situations = self._ring("situations", record.SITUATION)
        self.commands = self._ring("commands", record.COMMAND)
        self.notes = self._ring("notes", record.NOTE)
        self.requests = self._ring("desk", record.REQUEST)
        self.holds = self._ring("holds", record.HOLD)
        self.supervision = self._ring("supervision", record.NOTE)
        self._claimed = -1  # descriptor of the folder
        self._rings: dict[pathlib.Path, tuple[int, bytes]] = {}  # inode and header of each
        self.cleared: list[str] = []
        """Links, pipes and folders that stood in place of files and were removed, for the operator."""

    @classmethod
    def of(cls, rig: str, base: pathlib.Path | None = None) -> Runtime:
        """The folder of the daemon of ``rig``; ``base``: see `rigctl.config.layout.run_base`, else ``BASE``."""
        return cls((base or BASE) / f"rigctl-{rig}")

    @classmethod
    def entered(cls, directory: str | pathlib.Path) -> Runtime:
        """The folder of a daemon as its processes use it: by a descriptor, so that nobody can put another in its place.

        Raises:
            FolderError: it is a link, belongs to another user than this process or its parent folder's owner, or others
                may write to it.
        """
        path = pathlib.Path(directory)
        try:
            fd = os.open(path, _FOLDER_FLAGS)
        except OSError as error:
            raise FolderError(f"{path} cannot be entered: {error.strerror}") from None
        found = os.fstat(fd)
        owners = {os.geteuid()} | ({path.parent.lstat().st_uid} if path.parent == layout.RUN else set())
        if found.st_uid not in owners or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
            os.close(fd)
            mode = stat.S_IMODE(found.st_mode)
            raise FolderError(f"{path}: found user {found.st_uid} and mode {mode:04o}, expected the daemon's folder")
        return cls(_DESCRIPTORS / str(fd), shared=path.parent == layout.RUN)

    @property
    def descriptors(self) -> tuple[int, ...]:
        """Descriptors that a child process needs to find the folder by the same name: that of a folder `entered`."""
        return (int(self.directory.name),) if self.directory.parent == _DESCRIPTORS else ()

    def leave(self) -> None:
        """Close the descriptor of a folder that was `entered`."""
        for fd in self.descriptors:
            os.close(fd)

    def _ring(self, name: str, slot: record.Slot) -> RingFile:
        return RingFile(self.directory / writers.RINGS / name if self._shared else self.directory / name, slot)

    def claim(self) -> int:
        """Become the only daemon of this rig; returns the lock's file descriptor, held until the process ends.

        Raises:
            AlreadyRunningError: it names the process that holds the lock.
            FolderError: the folder cannot be made, or is not this user's alone.
        """
        folder = self._open_own()
        try:
            fd = self._open_lock(folder)
        except OSError as error:
            os.close(folder)
            raise FolderError(f"{self.directory}/{LOCK} cannot be made: {error.strerror}") from None
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            pid = os.read(fd, LONGEST_LOCK).decode(errors="replace").strip() or "unknown"
            os.close(fd)
            os.close(folder)
            raise AlreadyRunningError(f"another daemon (process {pid}) already runs this rig") from None
        try:
            self._sweep(folder)
            self._make_folders()
            os.ftruncate(fd, 0)
            os.pwrite(fd, f"{os.getpid()}\n".encode(), 0)
        except OSError as error:
            os.close(fd)
            os.close(folder)
            raise FolderError(f"{self.directory} cannot be used: {error.strerror}") from None
        self._claimed = folder
        return fd

    @property
    def _folder_mode(self) -> int:
        return 0o751 if self._shared else 0o711

    @property
    def file_mode(self) -> int:
        """Mode of rings and files."""
        return 0o640 if self._shared else 0o600

    def _open_own(self) -> int:
        """The folder's descriptor; a folder that another user could write to is refused."""
        try:
            with contextlib.suppress(FileExistsError):
                self.directory.mkdir(mode=0o700)
            found = self.directory.lstat()
        except OSError as error:
            raise FolderError(f"{self.directory}: the runtime folder cannot be made: {error.strerror}") from None
        what = ""
        if not stat.S_ISDIR(found.st_mode):
            what = "found a link" if stat.S_ISLNK(found.st_mode) else "found no folder"
        elif found.st_uid != os.geteuid():
            what = f"found a folder of user {found.st_uid}"
        elif found.st_mode & 0o077 & ~self._folder_mode:
            what = f"found mode {stat.S_IMODE(found.st_mode):04o}"
        if what:
            allowed = f"expected a folder of user {os.geteuid()} with mode {self._folder_mode:04o}"
            raise FolderError(f"{self.directory}: {what}, {allowed}; it was not used: remove it, or rename the rig")
        try:
            fd = os.open(self.directory, _FOLDER_FLAGS)
        except OSError as error:
            raise FolderError(f"{self.directory} cannot be opened: {error.strerror}") from None
        if not os.path.samestat(found, os.fstat(fd)):
            os.close(fd)
            raise FolderError(f"{self.directory}: it was replaced while the daemon started; start it again")
        os.fchmod(fd, self._folder_mode)
        return fd

    def _open_lock(self, folder: int) -> int:
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        with contextlib.suppress(FileNotFoundError):
            if not stat.S_ISREG(os.stat(LOCK, dir_fd=folder, follow_symlinks=False).st_mode):
                self._clear(folder, LOCK)
        fd = os.open(LOCK, flags, 0o600, dir_fd=folder)
        os.fchmod(fd, PUBLIC_MODE)  # clients and services find the daemon by the process number in it
        return fd

    def _sweep(self, folder: int) -> None:
        """Remove what is neither a file nor a socket of this user: links, pipes, folders. Files are made anew later."""
        for name in [entry.name for entry in os.scandir(folder)]:
            found = os.stat(name, dir_fd=folder, follow_symlinks=False)
            if name.startswith(_END) and stat.S_ISREG(found.st_mode):
                os.unlink(name, dir_fd=folder)
                continue
            if self._shared and name in (writers.RINGS, *writers.WRITERS) and stat.S_ISDIR(found.st_mode):
                shutil.rmtree(name, dir_fd=folder)
                continue
            plain = stat.S_ISSOCK(found.st_mode) or (stat.S_ISREG(found.st_mode) and found.st_nlink == 1)
            if found.st_uid != os.geteuid() or not plain:
                self._clear(folder, name)

    def _make_folders(self) -> None:
        """Make the folders of the processes that are services of their own."""
        if not self._shared:
            return
        (self.directory / writers.RINGS).mkdir()
        (self.directory / writers.RINGS).chmod(0o750)
        for name, writer in writers.WRITERS.items():
            folder, group = self.directory / name, writers.group_id(writer.group)
            folder.mkdir()
            fd = os.open(folder, _FOLDER_FLAGS)
            if group >= 0:
                os.fchown(fd, -1, group)
            os.fchmod(fd, 0o751 if group < 0 else 0o771)
            os.close(fd)

    def _clear(self, folder: int, name: str) -> None:
        self.cleared.append(f"{self.directory}/{name} was no file of the daemon, and has been removed")
        if stat.S_ISDIR(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode):
            shutil.rmtree(name, dir_fd=folder)
        else:
            os.unlink(name, dir_fd=folder)

    def lost(self) -> str:
        """Reason why the folder is no longer the one claimed, in words; empty while it is.

        A log-out may delete a user's folders in ``/dev/shm`` (``RemoveIPC`` in logind.conf).
        """
        try:
            found = self.directory.lstat()
        except FileNotFoundError:
            return "it has been deleted"
        except OSError:
            return ""  # a lack of descriptors or memory does not show that the folder is lost
        if not os.path.samestat(found, os.fstat(self._claimed)):
            return "it has been replaced by another"
        if found.st_uid != os.geteuid() or found.st_mode & 0o077 & ~self._folder_mode:
            return f"it has been given user {found.st_uid} and mode {stat.S_IMODE(found.st_mode):04o}"
        for path, made in self._rings.items():
            try:
                if identity(path) != made:
                    return f"{path.name} in it has been replaced or damaged"
            except FileNotFoundError:
                return f"{path.name} in it has been deleted"
            except OSError as error:
                if error.errno == errno.ELOOP:
                    return f"{path.name} in it has been replaced or damaged"
        return ""

    def make_rings(self, settings: RigSettings, *, history_s: int | None = None, notes: int = _NOTES) -> None:
        """Make fresh, empty rings and allocate their memory, so that no writer finds it full later.

        Args:
            settings: of the rig.
            history_s: time that the rings of records and frames hold, else the settings'.
            notes: slots of each ring whose writer is another process than the loop.

        Raises:
            RoomError: their memory is not free.
            OSError: the folder cannot be written.
        """
        history_s = history_s or settings.telemetry.history_s
        capacities = {
            self.records: settings.loop.rate_hz * history_s, self.frames: frames_held(settings, history_s),
            self.events: _SMALL_RING, self.commands: _SMALL_RING, self.replies: _SMALL_RING,
            self.situations: _FEW, self.holds: notes, self.notes: notes, self.requests: notes, self.supervision: notes,
        }  # fmt: skip
        disk = os.statvfs(self.directory)
        try:
            for ring, capacity in capacities.items():
                group = writers.group_id(writers.GROUP_OF.get(ring.path.name, "")) if self._shared else -1
                # Everyone who may enter the folder of the rings may read; besides the supervisor only the group writes.
                mode = self.file_mode if group < 0 else 0o664
                create(ring.path, ring.slot.dtype, capacity, mode=mode, group=group)
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            needed = sum(capacity * ring.slot.dtype.itemsize for ring, capacity in capacities.items())
            free = disk.f_bavail * disk.f_frsize
            words = f"the rings need {needed / 1e6:.1f} MB, {free / 1e6:.1f} MB are free{_MORE}"
            raise RoomError(error.errno, f"{error.strerror}: {words}", f"{self.directory}") from None
        self._rings = {ring.path: identity(ring.path) for ring in capacities}

    def remove(self) -> None:
        """Delete the folder; readers that still map a ring keep it until they release it.

        A folder made in place of the claimed one belongs to another daemon and is left alone.
        """
        try:
            folder = self._claimed if self._claimed >= 0 else os.open(self.directory, _FOLDER_FLAGS)
        except OSError:
            return
        with contextlib.suppress(OSError):
            for name in [entry.name for entry in os.scandir(folder)]:
                mode = os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode
                if stat.S_ISDIR(mode):
                    shutil.rmtree(name, dir_fd=folder)
                else:
                    os.unlink(name, dir_fd=folder)
            if os.path.samestat(self.directory.lstat(), os.fstat(folder)):
                self.directory.rmdir()
        os.close(folder)
        self._claimed = -1

    def end(self, process: str) -> None:
        """Have a process that is a service of its own end: see `rigctl.ipc.joining`.

        Raises:
            OSError: there is no room, or the folder is gone.
        """
        path = self.directory / f"{_END}{process}"
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o644))

    def is_to_end(self, process: str) -> bool:
        """Whether `end` was called for it in this run."""
        return (self.directory / f"{_END}{process}").exists()

    @property
    def gateway_cursor(self) -> pathlib.Path:
        """Position up to which the gateway has published, for the next gateway."""
        return self.place("gateway.cursor")

    @property
    def gateway_socket(self) -> pathlib.Path:
        """Socket of the gateway's router: for the gateway's command session, and for who may command."""
        return self.place(GATEWAY_SOCKET)

    @property
    def members(self) -> tuple[int, int]:
        """The groups of operators and of viewers: of the installed service alone, -1 without one."""
        names = (writers.OPERATORS, writers.VIEWERS)
        operators, viewers = (writers.group_number(name) if self._shared else -1 for name in names)
        return operators, viewers

    def let_members_connect(self, place: pathlib.Path) -> None:
        """Open a socket of the gateway's to its user, and of the installed service to operators and viewers.

        Raises:
            OSError: there is none, or the file system has no access lists.
        """
        place.chmod(0o600)
        if groups := [group for group in self.members if group >= 0]:
            access_list.admit(place, groups=groups)

    def write_json(self, name: str, value: Any, mode: int | None = None) -> None:
        """Replace ``name`` at once, so that a reader sees the old file or the new one; a second line is its SHA-256.

        Where others have taken all room, the old file is written over: a reader meanwhile finds a wrong SHA-256.
        ``mode``: of the file, else as of all files here.

        Raises:
            OSError: there is no room, or the folder is gone.
        """
        place = self.place(name)
        part = place.with_name(f".{name}.{threading.get_native_id()}")
        part.unlink(missing_ok=True)
        encoded = msgspec.json.encode(value)
        data = encoded + b"\n" + digest(encoded) + b"\n"
        try:
            fd = os.open(part, whole_file.NEW, 0o600)
            with open(fd, "wb") as file:  # noqa: PTH123 - a descriptor
                os.fchmod(fd, self.file_mode if mode is None else mode)
                file.write(data)
            try:
                part.rename(place)
            except IsADirectoryError:
                shutil.rmtree(place)
                part.rename(place)
        except BaseException as error:
            with contextlib.suppress(OSError):
                part.unlink(missing_ok=True)
            if not isinstance(error, OSError) or error.errno != errno.ENOSPC or not whole_file.over(place, data):
                raise
