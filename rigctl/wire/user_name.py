"""Names of this computer's users, and the name of an operator whose user the kernel knows."""

from __future__ import annotations

import pwd

LONGEST = 64
"""Letters of an operator's name."""
PAGE = "rigctl-page"
"""User of the installed service's page, which speaks for the person who has signed in there."""
_LONGEST_USER = 40


def user_name(uid: int) -> str:
    """A user's name; ``uid N`` without one that fits into an operator's name."""
    try:
        name = pwd.getpwuid(uid).pw_name
    except KeyError:
        return f"uid {uid}"
    fits = name.isprintable() and not set(name) & set(" ()") and len(name) <= _LONGEST_USER
    return name if fits else f"uid {uid}"


def with_user(name: str, user: str) -> str:
    """The operator's name of a user who gives ``name``, which may be empty: ``NAME (user)``, or his own name alone.

    ``user``: as the kernel says. It ends the name, so that nobody takes another's; what he gives is cut to what fits.
    A name that this function has made comes back as it was.
    """
    if user == PAGE and name:
        return name
    name, own = name.strip(), f" ({user})"
    while name.endswith(own):
        name = name.removesuffix(own)
    return user if name in ("", user) else f"{name[: LONGEST - len(own)].rstrip()}{own}"
