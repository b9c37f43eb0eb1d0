"""Operators of the tests, as the daemon knows them: with the user who runs the tests."""

from __future__ import annotations

import os

from rigctl.wire.user_name import user_name, with_user

USER = user_name(os.geteuid())
ANNA, KIM, LEE = (with_user(name, USER) for name in ("anna", "kim", "lee"))
