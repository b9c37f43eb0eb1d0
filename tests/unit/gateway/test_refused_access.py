"""Lines of Zenoh's log become few refusals, each with who and what; other lines become none."""

from __future__ import annotations

import pytest

from rigctl.gateway.refused_access import (
    ADDRESS_NS,
    GROUPS_MAX,
    LOCAL,
    PEERS_MAX,
    UNNAMED,
    AccessRefusal,
    RefusedAccess,
)
from rigctl.ipc.notes import Note

S = 1_000_000_000
HEAD = b"2026-11-22T23:08:50.839724Z TRACE  rx-0 "
ACL = b" zenoh::net::routing::interceptor::access_control: "
ACCEPTED = (
    b"2026-11-22T23:08:50.8Z DEBUG acc-0 ThreadId(05) zenoh_transport::unicast::establishment::accept: New transport "
    b"link accepted from 56a to 77b: TransportLinkUnicast { link: Link { src: tls/127.0.0.1:7447, "
    b"dst: tls/192.0.2.9:51234, group: None } }\n"
)
DROPPED = b" zenoh::net::routing::interceptor: Msg intercepted!\n"


def judged(
    what: bytes, key: bytes, *, session: bytes = b"56a", thread: bytes = b"ThreadId(07)", flow: bytes = b"ingress"
) -> bytes:
    who = session + b" on Interface(lo)+CertCommonName(vera.584f)+Transport(Tls)+" + session
    return HEAD + thread + ACL + who + b" is unauthorized to " + what + b" (" + flow + b") on " + key + b"\n"


def dropped(thread: bytes = b"ThreadId(07)") -> bytes:
    return HEAD + thread + DROPPED


def taken(found: RefusedAccess, *lines: bytes, now_ns: int = 0) -> list[AccessRefusal]:
    for line in lines:
        found.take(line, now_ns)
    return found.due(now_ns)


def test_a_message_that_was_dropped_is_one_refusal_with_name_certificate_and_key() -> None:
    (one,) = taken(RefusedAccess(), ACCEPTED, judged(b"Query", b"rigctl/r/cmd/vera/hold"), dropped())
    assert (one.note, one.who) == (Note.MESSAGE_REFUSED, "vera")
    assert one.other == "certificate vera.584f, tls/192.0.2.9:51234"
    assert one.words == "query of rigctl/r/cmd/vera/hold"


@pytest.mark.parametrize(
    ("transport", "address", "other"),
    [
        (b"UnixsockStream", b"unixsock-stream/5d4f", LOCAL),
        (b"Tcp", b"tcp/127.0.0.1:51234", f"{UNNAMED}, tcp/127.0.0.1:51234"),
    ],
)
def test_without_a_certificate_it_is_the_link_that_is_said(transport: bytes, address: bytes, other: str) -> None:
    accepted = ACCEPTED.replace(b"tls/192.0.2.9:51234", address)
    line = judged(b"Put", b"k").replace(
        b"Interface(lo)+CertCommonName(vera.584f)+Transport(Tls)", b"Transport(%s)" % transport
    )
    (one,) = taken(RefusedAccess(), accepted, line, dropped())
    assert (one.who, one.other) == ("", other)


@pytest.mark.parametrize("late", [False, True])
def test_the_address_is_said_also_when_zenoh_writes_it_after_the_refusal(late: bool) -> None:
    """One thread accepts a session, others take what it sends."""
    found, refused = RefusedAccess(), (judged(b"Query", b"rigctl/r/cmd/vera/hold"), dropped())
    assert taken(found, *((ACCEPTED,) if not late else refused)) == []
    (one,) = taken(found, *((ACCEPTED,) if late else refused), now_ns=ADDRESS_NS // 2)
    assert one.other == "certificate vera.584f, tls/192.0.2.9:51234"


def test_a_refusal_is_said_without_an_address_that_zenoh_never_writes() -> None:
    found = RefusedAccess()
    assert taken(found, judged(b"Put", b"k"), dropped()) == []
    assert [one.other for one in taken(found, now_ns=ADDRESS_NS)] == ["certificate vera.584f"]


def test_what_zenoh_only_judges_ahead_or_drops_on_the_way_out_is_none() -> None:
    found = RefusedAccess()
    assert taken(found, judged(b"Put", b"rigctl/r/cmd"), judged(b"Delete", b"rigctl/r/cmd")) == []
    assert taken(found, judged(b"Put", b"a", thread=b"ThreadId(08)"), dropped(b"ThreadId(09)")) == []
    assert taken(RefusedAccess(), judged(b"Put", b"a", flow=b"egress"), dropped()) == []
    assert taken(RefusedAccess(), b"", b"\xff\xfe", HEAD, dropped()) == []


def test_more_of_a_kind_is_reported_together_and_ever_less_often() -> None:
    found = RefusedAccess()
    reported = []
    for second in range(4000):
        lines = (ACCEPTED, judged(b"Put", b"k%d" % second), dropped())
        reported += [(second, one.number) for one in taken(found, *lines, now_ns=second * S)]
    assert [second for second, _ in reported] == [0, 10, 30, 70, 150, 310, 630, 1270, 2550]
    assert sum(number for _, number in reported) == 2551
    assert taken(found, now_ns=8000 * S)[0].words == "put of k3999 (1449 times in 5449 s)"


def test_a_key_cannot_pass_for_another_line() -> None:
    """A line of the log is one datagram, whatever is in it."""
    false = b"x\n" + judged(b"Put", b"y").replace(b"vera", b"kim") + dropped()
    (one,) = taken(RefusedAccess(), ACCEPTED, judged(b"Put", false), dropped())
    assert one.who == "vera"
    assert one.words.startswith("put of x\\n2026")
    assert "\n" not in one.words


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (b"peer sent no certificates", "it has no certificate"),
        (b"invalid peer certificate: UnknownIssuer", "its certificate is of another authority"),
        (b"invalid peer certificate: certificate expired: verification time 1", "its certificate has expired"),
        (b"received fatal alert: UnknownCA", "it does not accept the certificate of this rig"),
        (b"received corrupt message of type InvalidContentType", "it speaks no TLS"),
        (b"something\nnew", "TLS failed: something\\nnew"),
    ],
)
def test_a_refused_connection_is_said_in_words(said: bytes, why: str) -> None:
    line = b"2026-11-22T23:08:51Z  WARN acc-0 ThreadId(04) zenoh_link_tls::unicast: " + said
    (one,) = taken(RefusedAccess(), line + b". Hint: increase the system open file limit.\n")
    assert (one.note, one.who, one.other, one.words) == (Note.CONNECTION_REFUSED, "", "", why)


def test_memory_is_bounded_whatever_comes() -> None:
    found = RefusedAccess()
    for number in range(3 * PEERS_MAX):
        session = b"%x" % (number + 1)
        line = judged(b"Put", b"k", session=session).replace(b"vera.584f", b"p%d.1" % number)
        taken(found, line, dropped(), now_ns=number)
    assert len(found._groups) <= GROUPS_MAX + 1
    assert len(found._names) <= PEERS_MAX
