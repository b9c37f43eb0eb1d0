"""An operator's name, which nobody can take from another user."""

from __future__ import annotations

import pwd

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigctl.wire.command_request import operator_of
from rigctl.wire.user_name import LONGEST, PAGE, user_name, with_user

USERS = st.sampled_from(["root", "kim", "uid 4711", "x" * 40])


@pytest.mark.parametrize(
    ("name", "user", "shown"),
    [
        ("", "kim", "kim"), ("kim", "kim", "kim"), ("kim (kim)", "kim", "kim"),
        ("anna", "lab", "anna (lab)"), ("anna (lab)", "lab", "anna (lab)"), ("anna (lab) (lab)", "lab", "anna (lab)"),
        ("anna (lab)", "kim", "anna (lab) (kim)"), ("root", "kim", "root (kim)"),
        ("anna", PAGE, "anna"), ("anna (kim)", PAGE, "anna (kim)"), ("", PAGE, PAGE), (PAGE, "kim", f"{PAGE} (kim)"),
    ],
)  # fmt: skip
def test_the_name_given_comes_before_the_users_and_only_the_page_speaks_for_another(
    name: str, user: str, shown: str
) -> None:
    assert with_user(name, user) == shown
    assert with_user(shown, user) == shown


@given(name=st.text(max_size=120), user=USERS)
def test_whatever_is_given_it_ends_with_the_user_and_fits(name: str, user: str) -> None:
    shown = with_user(name, user)
    assert shown == user or shown.endswith(f" ({user})")
    assert len(shown) <= LONGEST
    if shown.isprintable():
        assert operator_of(shown) == shown


@pytest.mark.parametrize(("name", "shown"), [("kim", "kim"), ("CORP\\kim", "CORP\\kim"), ("kim (root)", "uid 1"),
                                             ("a\nb", "uid 1"), ("k" * 41, "uid 1"), (None, "uid 1")])  # fmt: skip
def test_a_users_name_is_one_word_or_his_number(monkeypatch: pytest.MonkeyPatch, name: str | None, shown: str) -> None:
    def found(_uid: int) -> pwd.struct_passwd:
        if name is None:
            raise KeyError
        return pwd.struct_passwd((name, "x", 1, 1, "", "/", "/bin/sh"))

    monkeypatch.setattr(pwd, "getpwuid", found)
    assert user_name(1) == shown
