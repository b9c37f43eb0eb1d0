"""Key folder: what is issued, who may read it, and what is refused in one line."""

from __future__ import annotations

import datetime
import errno
import os
import pathlib
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from rigctl.identity import credentials
from rigctl.identity.certificates import hosts_of
from rigctl.identity.credentials import CredentialsError
from rigctl.identity.issuing import KeyIssuer
from rigctl.identity.key_folder import HostError, KeyFolder, KeyFolderError
from rigctl.identity.roles import PEOPLE, Role
from rigctl.ipc import whole_file
from rigctl.wire.access_control import access_control
from tests.builders.paths import ROOT
from tests.builders.waiting import patience_s

NOW = datetime.datetime(2026, 3, 1, 12, tzinfo=datetime.UTC)
DAY = datetime.timedelta(days=1)


@pytest.fixture
def issuer(tmp_path: pathlib.Path) -> KeyIssuer:
    made = KeyIssuer(tmp_path / "keys", NOW)
    made.init(["rig-pc", "192.168.1.10"])
    return made


def certificate(text: str) -> x509.Certificate:
    return x509.load_pem_x509_certificate(text.encode())


def of_name(found: x509.Certificate, oid: x509.ObjectIdentifier) -> list[str | bytes]:
    return [attribute.value for attribute in found.subject.get_attributes_for_oid(oid)]


def test_only_the_owner_may_read_anything_in_the_folder(issuer: KeyIssuer) -> None:
    issuer.add("kim", Role.OPERATOR)
    path = issuer.folder.path
    assert path.stat().st_mode & 0o777 == 0o700
    for file in path.rglob("*"):
        assert file.stat().st_mode & 0o777 == (0o700 if file.is_dir() else 0o600), file


@pytest.mark.parametrize("role", PEOPLE)
def test_a_certificate_names_its_holder_and_role_and_is_signed(issuer: KeyIssuer, role: Role) -> None:
    made = issuer.add("kim", role)
    owned = credentials.read(issuer.folder.issued("kim"))
    found, authority = certificate(owned.certificate), certificate(owned.authority)
    found.verify_directly_issued_by(authority)
    assert (owned.name, owned.role) == ("kim", role)
    assert of_name(found, NameOID.COMMON_NAME) == [made.common_name]
    assert of_name(found, NameOID.ORGANIZATIONAL_UNIT_NAME) == [role.value]
    assert found.not_valid_after_utc == owned.not_after == NOW + 365 * DAY
    assert found.not_valid_before_utc < NOW


def test_no_person_can_stand_in_for_the_gateway(issuer: KeyIssuer) -> None:
    """A person's certificate is good for a client alone."""
    issuer.add("kim", Role.MAINTAINER)
    purposes = {}
    for file in (issuer.folder.issued("kim"), issuer.folder.gateway):
        found = certificate(credentials.read(file).certificate)
        purposes[file.stem] = set(found.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
        assert not found.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    client, server = ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH
    assert purposes == {"kim": {client}, "gateway": {client, server}}


def test_the_gateways_certificate_has_the_hosts_also_when_it_is_renewed(issuer: KeyIssuer) -> None:
    def hosts() -> set[str]:
        names = certificate(credentials.read(issuer.folder.gateway).certificate).extensions
        found = names.get_extension_for_class(x509.SubjectAlternativeName).value
        return {str(name.value) for name in found}

    before = hosts()
    assert {"localhost", "127.0.0.1", "::1", "rig-pc", "192.168.1.10"} <= before
    issuer.renew("gateway")
    assert hosts() == before
    issuer.renew("gateway", hosts=["other-pc"])
    assert "other-pc" in hosts() and "rig-pc" not in hosts()


NO_HOSTS = [
    "",
    " ",
    "*",
    "*.lab",
    "tcp/rig-pc:7447",
    "rig-pc:7447",
    "rig\npc",
    "Ü",
    "r" * 300,
    "300.1.1.1",
    "-pc",
    "a..b",
]


@pytest.mark.parametrize("host", NO_HOSTS)
def test_what_is_no_host_is_refused_and_leaves_no_folder(tmp_path: pathlib.Path, host: str) -> None:
    made = KeyIssuer(tmp_path / "keys", NOW)
    with pytest.raises(HostError, match=r"--host: found .*, expected a host name"):
        made.init([host])
    assert not list(tmp_path.iterdir())
    made.init(["rig-pc", "rig.lab.example", "fe80::1"])
    with pytest.raises(HostError):
        made.add("hall", Role.PAGE, hosts=[host])
    with pytest.raises(HostError):
        made.renew("gateway", hosts=[host])
    assert [one.name for one in made.folder.certificates()] == ["gateway"]


def test_a_folder_that_could_not_be_written_to_its_end_has_no_keys(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made, written = KeyIssuer(tmp_path / "keys", NOW), whole_file.replace

    def full(file: pathlib.Path, data: bytes, **options: Any) -> None:
        if file.name == "access.json":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written(file, data, **options)

    monkeypatch.setattr(whole_file, "replace", full)
    with pytest.raises(OSError, match="No space"):
        made.init([])
    assert not list(made.folder.path.glob("[!.]*"))
    monkeypatch.undo()
    made.init([])


def test_a_renewed_key_has_another_common_name_and_the_former_stays_good(issuer: KeyIssuer) -> None:
    first = issuer.add("kim", Role.OPERATOR)
    second = issuer.renew("kim", days=10)
    assert first.common_name != second.common_name
    assert second.role is Role.OPERATOR and second.not_after == NOW + 10 * DAY
    assert [one.is_valid(NOW) for one in issuer.folder.certificates()] == [True] * 3


def test_a_revoked_key_stays_refused_when_its_owner_gets_a_new_one(issuer: KeyIssuer) -> None:
    issuer.add("kim", Role.MAINTAINER)
    assert issuer.revoke("kim") == 1
    with pytest.raises(KeyFolderError, match="kim was revoked"):
        issuer.renew("kim")
    issuer.add("kim", Role.VIEWER)
    found = [one for one in issuer.folder.certificates() if one.name == "kim"]
    assert [(one.role, one.standing(NOW)) for one in found] == [(Role.MAINTAINER, "revoked"), (Role.VIEWER, "valid")]
    assert len({one.common_name for one in found}) == 2


def test_a_key_ends_with_its_date_and_never_after_its_authority(issuer: KeyIssuer) -> None:
    made = issuer.add("kim", Role.VIEWER, days=3)
    assert made.is_valid(NOW + 3 * DAY - datetime.timedelta(seconds=1))
    assert made.standing(NOW + 3 * DAY) == "expired"
    late = KeyIssuer(issuer.folder.path, NOW + 3600 * DAY)
    assert late.add("anna", Role.VIEWER).not_after == NOW + 3650 * DAY


def test_a_wrong_clock_does_not_keep_a_gateway_from_its_start(issuer: KeyIssuer) -> None:
    unset, typed = (datetime.datetime(year, 1, 1, tzinfo=datetime.UTC) for year in (1970, 2099))
    made = issuer.add("kim", Role.VIEWER)
    assert [made.standing(clock) for clock in (unset, NOW, typed)] == ["not yet valid", "valid", "expired"]
    for clock in (unset, NOW, typed):
        issuer.folder.check_gateway(clock)
    with pytest.raises(KeyFolderError, match="expired on 2028-06-03: rigctl keys renew gateway"):
        issuer.folder.check_gateway(NOW + 900 * DAY)


def test_the_authoritys_key_may_be_kept_elsewhere(issuer: KeyIssuer) -> None:
    """Without it nobody gets a key, and a key is revoked all the same."""
    issuer.add("kim", Role.OPERATOR)
    (issuer.folder.path / "authority.key").unlink()
    with pytest.raises(KeyFolderError, match=r"authority\.key: cannot be read.*put it back"):
        issuer.add("anna", Role.VIEWER)
    assert issuer.revoke("kim") == 1


@pytest.mark.parametrize("name", ["authority.pem", "authority.key", "gateway.pem", "access.json"])
@pytest.mark.parametrize("at", [0, 60, -1])
def test_a_byte_that_is_not_utf_8_is_refused_in_one_line(issuer: KeyIssuer, name: str, at: int) -> None:
    file = issuer.folder.path / name
    data = bytearray(file.read_bytes())
    data[at] = 0xFF
    file.write_bytes(data)
    with pytest.raises(KeyFolderError, match=name) as refused:
        issuer.add("kim", Role.VIEWER)
        issuer.folder.gateway_credentials()
    assert "\n" not in str(refused.value)


def test_a_folder_in_the_place_of_a_key_file_is_refused_by_its_name(tmp_path: pathlib.Path) -> None:
    with pytest.raises(CredentialsError, match=f"{tmp_path}: found no plain file"):
        credentials.read(tmp_path)


@pytest.mark.parametrize("name", ["", "gateway", "Kim", "kim/x", "kim*", "../kim", "k" * 33, "kim.1", "kim "])
def test_a_name_that_would_change_a_key_or_a_file_is_refused(issuer: KeyIssuer, name: str) -> None:
    with pytest.raises(KeyFolderError, match="found the name"):
        issuer.add(name, Role.VIEWER)


def linked(folder: KeyFolder) -> None:
    folder.path.rename(folder.path.with_name("away"))
    folder.path.symlink_to("away")


DAMAGES: dict[str, tuple[Callable[[KeyFolder], object], str]] = {
    "open folder": (lambda folder: folder.path.chmod(0o750), "found mode 0750, expected 0700"),
    "no folder": (lambda folder: folder.path.rename(folder.path.with_name("away")), "rigctl keys init"),
    "a link": (linked, "found no folder"),
    "another's folder": (lambda folder: os.chown(folder.path, 65534, 65534), "found a folder of uid 65534"),
    "open key": (lambda folder: folder.gateway.chmod(0o640), r"gateway\.pem: found mode 0640, expected 0600"),
    "another's key": (lambda folder: os.chown(folder.gateway, 65534, 65534), r"gateway\.pem: found a file of uid"),
    "no key": (lambda folder: folder.gateway.unlink(), r"gateway\.pem: cannot be read: No such file"),
    "half a key": (lambda folder: folder.gateway.write_text("-----BEGIN"), r"gateway\.pem: found no key, expected"),
    "access not JSON": (lambda folder: folder.access.write_text("{"), r"access\.json: found damaged content"),
    "no access file": (lambda folder: folder.access.unlink(), r"access\.json: No such file"),
    "a later access file": (
        lambda folder: folder.access.write_text('{"version": 2, "certificates": []}'),
        "found version 2, expected 1",
    ),
    "a name with a star": (
        lambda folder: folder.access.write_text(folder.access.read_text().replace('"gateway"', '"**"', 1)),
        "found a certificate of",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_folder_that_cannot_be_believed_is_refused_in_one_line(issuer: KeyIssuer, damage: str) -> None:
    if "another" in damage and os.geteuid() != 0:
        pytest.skip("only root can give a file away")
    change, expected = DAMAGES[damage]
    change(issuer.folder)
    with pytest.raises(KeyFolderError, match=expected) as refused:
        issuer.folder.certificates()
        issuer.folder.gateway_credentials()
    assert "\n" not in str(refused.value)


def test_a_key_file_hides_its_key_when_it_is_printed(issuer: KeyIssuer) -> None:
    assert "PRIVATE" not in repr(credentials.read(issuer.folder.gateway))


def test_a_key_file_that_is_a_pipe_does_not_block(tmp_path: pathlib.Path) -> None:
    os.mkfifo(tmp_path / "pipe.pem", 0o600)
    with pytest.raises(CredentialsError, match="found no plain file"):
        credentials.read(tmp_path / "pipe.pem")


# -- the command ----------------------------------------------------------------------------------------------------
def keys(folder: pathlib.Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rigctl", "keys", *arguments, "--dir", str(folder)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False, timeout=patience_s())


def test_the_command_makes_issues_lists_and_revokes(tmp_path: pathlib.Path) -> None:
    folder = tmp_path / "keys"
    for arguments in (["init"], ["add", "kim", "--role", "operator"], ["revoke", "kim"]):
        done = keys(folder, *arguments)
        assert (done.returncode, done.stderr) == (0, ""), arguments
    shown = keys(folder, "list").stdout.splitlines()
    assert [line.split()[:2] for line in shown] == [["gateway", "gateway"], ["kim", "operator"]]
    assert " revoked 20" in shown[1]


@pytest.mark.parametrize(
    ("arguments", "code", "expected"),
    [
        (["init", "kim"], 2, "found a NAME"),
        (["add"], 2, "found no NAME"),
        (["add", "kim"], 2, "found no --role"),
        (["add", "kim", "--role", "admin"], 2, "found --role 'admin', expected viewer, operator, maintainer"),
        (["add", "kim", "--role", "viewer", "--host", "x"], 2, "found --host"),
        (["init", "--host", "*"], 2, "--host: found '*', expected a host name"),
        (["add", "kim", "--role", "viewer"], 1, "rigctl keys init"),
        (["list"], 1, "rigctl keys init"),
    ],
)
def test_wrong_usage_is_one_line(tmp_path: pathlib.Path, arguments: list[str], code: int, expected: str) -> None:
    done = keys(tmp_path / "none", *arguments)
    assert done.returncode == code and expected in done.stderr
    assert done.stderr.count("\n") == 1 and done.stdout == ""


def test_a_pages_key_is_good_for_https_and_nothing_else(issuer: KeyIssuer) -> None:
    made = issuer.add("page", Role.PAGE, hosts=["page-pc", "192.168.1.11"])
    owned = credentials.read(issuer.folder.issued("page"))
    found = certificate(owned.certificate).extensions
    assert [*found.get_extension_for_class(x509.ExtendedKeyUsage).value] == [ExtendedKeyUsageOID.SERVER_AUTH]
    names = found.get_extension_for_class(x509.SubjectAlternativeName).value
    assert {"localhost", "page-pc"} <= {*names.get_values_for_type(x509.DNSName)}
    assert "192.168.1.11" in [str(one) for one in names.get_values_for_type(x509.IPAddress)]
    assert made.common_name not in str(access_control("rig", "1a", issuer.folder.certificates(), NOW))
    issuer.renew("page")
    again = credentials.read(issuer.folder.issued("page"))
    assert sorted(hosts_of(again.certificate)) == sorted(hosts_of(owned.certificate))
    issuer.folder.issued("page").unlink()
    with pytest.raises(KeyFolderError, match="name the hosts of the page with --host"):
        issuer.renew("page")
    issuer.add("kim", Role.OPERATOR)
    with pytest.raises(KeyFolderError, match="found --host for kim, operator"):
        issuer.renew("kim", hosts=["here"])
    for role in Role:
        assert not role.includes(Role.PAGE)
        assert not Role.PAGE.includes(role)
