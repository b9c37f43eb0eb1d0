"""Numbers typed and pasted into the page's fields: the server reads the text as the command line does."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser

from tests.builders.operators import KIM
from tests.builders.pages import PageView, Server, look
from tests.builders.stand_in import TRIP_N

NOT_READ = {
    "a decimal comma": ("290,5", "found '290,5', expected a number of newtons with a decimal point, such as 290.5"),
    "a minus sign": ("\u2212290", "found '\u2212290', expected a number of newtons such as 290.5"),
    "another decimal comma": ("10,5", "found '10,5', expected a number of newtons with a decimal point"),
    "an underscore": ("3_00", "found '3_00', expected a number of newtons such as 290.5"),
    "full-width digits": ("\uff12\uff19\uff10", "found '\uff12\uff19\uff10', expected a number of newtons such as"),
    "nothing": ("", "found '', expected a number of newtons such as 290.5"),
}


@pytest.fixture
def seen(chromium: Browser, commanding: Server) -> Iterator[PageView]:
    found = look(chromium, commanding.address)
    found.live()
    found.until("!document.querySelector('#commands').hidden")
    yield found
    found.page.close()


def said(seen: PageView, words: str) -> None:
    seen.until(f"document.querySelector('#said').textContent.includes({words!r})")


def entered(seen: PageView, field: str, text: str, *, pasted: bool) -> None:
    """Type text into an empty field, or paste it, and press Enter."""
    seen.page.fill(field, "")
    seen.page.focus(field)
    if pasted:
        seen.page.keyboard.insert_text(text)  # an input event without keys, as a paste makes it
    else:
        seen.page.keyboard.type(text)
    assert seen.run(f"document.querySelector({field!r}).value") == text
    seen.page.keyboard.press("Enter")


@pytest.mark.parametrize("pasted", [False, True], ids=["typed", "pasted"])
@pytest.mark.parametrize(("text", "words"), NOT_READ.values(), ids=NOT_READ)
def test_a_target_that_is_no_number_is_refused_and_not_asked_about(
    seen: PageView, text: str, words: str, pasted: bool
) -> None:
    entered(seen, "#newtons", text, pasted=pasted)
    said(seen, f"TARGET: {words}")
    assert seen.run("document.querySelector('#confirm').hidden")


def test_a_decimal_point_is_read(seen: PageView, commanding: Server) -> None:
    entered(seen, "#newtons", "290.5", pasted=False)
    seen.until("document.querySelector('#confirm-text').textContent.startsWith('TARGET: hold 290.5 N instead of ')")
    seen.page.click("#confirm-no")
    assert commanding.command("lease", {"act": "return"})[0] == 200


def test_the_bounds_are_beside_the_fields(seen: PageView) -> None:
    for field, words in {
        "newtons": "50 to 350 N", "seconds": "1 to 3600 s", "millimetres": "up to ", "shelve-minutes": "0.1 to 480 min",
    }.items():  # fmt: skip
        seen.until(f"document.getElementById('{field}-bounds').textContent.startsWith({words!r})")
        assert seen.run(f"document.getElementById({field!r}).getAttribute('aria-describedby')") == f"{field}-bounds"


def test_what_is_no_length_pays_out_nothing_and_ramps_nothing(chromium: Browser, own_page: Server) -> None:
    """A length that could not be read had been left out, and RELEASE was the ramp to a slack rope."""
    seen = look(chromium, own_page.address)
    seen.live()
    seen.until("!document.querySelector('#commands').hidden")
    for verb, body in (("arm", {}), ("target", {"value": "290.5"})):
        status, proposed = own_page.command("command", {"verb": verb, **body})
        assert status == 200, proposed
        assert own_page.command("confirm", {"confirm": proposed["confirm"]})[0] == 200
    seen.until("rigctl.state.mode === 'HOLD'")
    for text in ("10,5", "\u221210", "five"):
        entered(seen, "#millimetres", text, pasted=False)
        said(seen, f"RELEASE: found {text!r}, expected a number of millimetres")
        assert seen.run("document.querySelector('#confirm').hidden")
    seen.page.close()


def test_the_time_of_a_shelf_is_read_alike_and_the_form_stays_until_it_is(chromium: Browser, own_page: Server) -> None:
    seen = look(chromium, own_page.address)
    seen.live()
    seen.until("!document.querySelector('#commands').hidden")
    for verb, body in (("arm", {}), ("target", {"value": str(TRIP_N)})):  # this target trips the loop's stand-in
        proposed = own_page.command("command", {"verb": verb, **body})[1]
        own_page.command("confirm", {"confirm": proposed["confirm"]})
    seen.until("document.querySelector('[data-act=shelve]') !== null")
    seen.page.click("[data-act=shelve]")
    seen.page.fill("#shelve-reason", "a test")
    for text, words in (("1,5", "SHELVE: found '1,5', expected a number of minutes with a decimal point"),
                        ("481", "SHELVE: found 481, expected 0.1 to 480 minutes")):  # fmt: skip
        entered(seen, "#shelve-minutes", text, pasted=False)
        said(seen, words)
        assert not seen.run("document.querySelector('#shelve').hidden")
    entered(seen, "#shelve-minutes", "1.5", pasted=False)
    said(seen, f"{KIM} shelves the alarm TENSION_HIGH for 90 s: a test")
    seen.until("document.querySelector('#shelve').hidden")
    seen.page.close()
