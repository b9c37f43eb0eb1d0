"""Equation (15) derived by SymPy from L = T - U, in coordinates of its own: what the compiled plant is judged by.

Nothing of the plant's is used but its parameters' names. Units are the plant's: mm, N, t, s.

A derivation takes half a minute, so its result is kept in ``derived/``, under the hash of this file; `make test-live`
derives it anew. ``python -m tests.plant.lagrangian`` writes the files.
"""

from __future__ import annotations

import gzip
import hashlib
import inspect
import math
import pathlib
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import sympy as sp

Floats = npt.NDArray[np.float64]

G = sp.Float(9806.65)
NAMES = (
    "rope_length",
    "free_length",
    "stiffness",
    "damping",
    "rope_mass",
    "node_damping",
    "radius",
    "eccentricity_x",
    "eccentricity_y",
    "rail_inertia",
    "rail_slope",
    "rail_viscous",
    "pulley_mass",
    "pulley_viscous",
    "payload",
    "extra",
    "kt",
    "kn",
    "kz",
    "ct",
    "cn",
    "cz",
    "force_t",
    "force_n",
    "force_z",
    "level0",
    "level1",
    "level2",
    "level3",
    "level_start",
)
"""Symbols of constants; ``level0`` to ``level3`` are the cubic of the rail's level over its angle past the start."""
PRESCRIBED = ("psi", "high", "gx", "gy", "gz", "stroke")
"""Each with its rate and acceleration: angle and height of the mechanism, floor (normal, tangential, up), stroke."""


class Motion(NamedTuple):
    """Accelerations: of the coordinates, and of the payload along the mechanism's axes (u)."""

    coordinates: Floats
    payload: Floats


def derive(
    q: Sequence[Any], rates: Sequence[Any], kinetic: Any, potential: Any, dissipation: Any, u: Sequence[Any]
) -> str:
    """Source of the function that evaluates mass, force, across and bias, see `Lagrangian`.

    ``u`` is the payload's displacement from where the mechanism prescribes it.
    """
    fixed, moving, accelerating = ([sp.Symbol(name + suffix) for name in PRESCRIBED] for suffix in ("", "_v", "_a"))
    q_, rates_ = sp.Matrix(q), sp.Matrix(rates)
    u_ = sp.Matrix(u)
    momentum = sp.Matrix([kinetic]).jacobian(rates_).T

    def derivative(vector: Any) -> Any:
        """Total time derivative, less what is due to the coordinates' accelerations."""
        return (
            vector.jacobian(q_) * rates_
            + vector.jacobian(fixed) * sp.Matrix(moving)
            + vector.jacobian(moving) * sp.Matrix(accelerating)
        )

    mass = momentum.jacobian(rates_)
    force = sp.Matrix([kinetic - potential]).jacobian(q_).T - sp.Matrix([dissipation]).jacobian(rates_).T
    force -= derivative(momentum)
    across = u_.jacobian(q_)
    bias = derivative(derivative(u_))
    arguments = [*q, *rates, *fixed, *moving, *accelerating, *map(sp.Symbol, NAMES)]
    evaluate = sp.lambdify(arguments, [part.tolist() for part in (mass, force, across, bias)], modules="math", cse=True)
    return inspect.getsource(evaluate)


class Lagrangian:
    """A system given by its energies, as `derive` has written it."""

    def __init__(self, source: str) -> None:
        names: dict[str, Any] = dict(vars(math))
        exec(source, names)
        self._evaluate: Callable[..., Any] = names["_lambdifygenerated"]

    def accelerations(
        self, q: Floats, rates: Floats, prescribed: Floats, constants: dict[str, float], free: Sequence[bool]
    ) -> Motion:
        """Accelerations with the mechanism rigid (a constraint with its multiplier) where not ``free``.

        Args:
            q, rates: coordinates.
            prescribed: values, rates and accelerations (3 rows) of ``PRESCRIBED``.
            constants: of ``NAMES``.
            free: whether the payload moves along the tangential, normal and vertical axis.
        """
        found = self._evaluate(*q, *rates, *prescribed.ravel(), *(constants[name] for name in NAMES))
        mass, force, across, bias = (np.array(part, dtype=np.float64) for part in found)
        held = ~np.array(free)
        count, size = int(held.sum()), len(q)
        scale = 1.0 / np.sqrt(np.diag(mass))  # lengths and angles in one matrix: without it digits are lost
        bars = across[held] * scale
        matrix = np.zeros((size + count, size + count))
        matrix[:size, :size] = mass * np.outer(scale, scale)
        matrix[:size, size:] = bars.T
        matrix[size:, :size] = bars
        right = np.concatenate([force[:, 0] * scale, -bias[held, 0]])
        weights = np.ones(size + count)
        weights[size:] = 1.0 / np.linalg.norm(bars, axis=1)
        matrix *= np.outer(weights, weights)
        solution = np.linalg.solve(matrix, right * weights)
        solution += np.linalg.solve(matrix, right * weights - matrix @ solution)
        acceleration = solution[:size] * scale
        return Motion(acceleration, across @ acceleration + bias[:, 0])


_S = {name: sp.Symbol(name) for name in (*NAMES, *PRESCRIBED, *(f"{name}_v" for name in PRESCRIBED))}


def _rate(vector: Any, q: Sequence[Any], rates: Sequence[Any]) -> Any:
    """Velocity of a place given by coordinates and what is prescribed."""
    places, speeds = [_S[name] for name in PRESCRIBED], [_S[f"{name}_v"] for name in PRESCRIBED]
    return vector.jacobian(q) * sp.Matrix(rates) + vector.jacobian(places) * sp.Matrix(speeds)


def _square(vector: Any) -> Any:
    return (vector.T * vector)[0]


def _rail(x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Angle, radius and height of the pulley at (x, y), x along the tangent, y along the normal at angle 0."""
    along, outwards = x - _S["eccentricity_y"] - _S["gy"], y - _S["eccentricity_x"] - _S["gx"]
    phi, r = sp.atan2(along, outwards), sp.sqrt(along**2 + outwards**2)
    past = phi - _S["level_start"]
    level = sum(_S[f"level{n}"] * past**n for n in range(4))
    return phi, r, level + _S["rail_slope"] * (r - _S["radius"]) + _S["gz"]


def _payload(place: Any) -> list[Any]:
    """Displacement from the prescribed place along the mechanism's tangential, normal and vertical axes."""
    sine, cosine = sp.sin(_S["psi"]), sp.cos(_S["psi"])
    return [
        place[0] * cosine - place[1] * sine,
        place[0] * sine + place[1] * cosine - _S["radius"],
        place[2] + _S["rope_length"] - _S["high"],
    ]


def _assemble(
    q: Sequence[Any],
    rates: Sequence[Any],
    upper: Any,
    lower: Any,
    length: Any,
    rope_kinetic: Any,
    node_dissipation: Any,
) -> str:
    phi, r, _ = _rail(q[0], q[1])
    u = sp.Matrix(_payload(lower))
    u_rate = _rate(u, q, rates)
    turn, slide = _rate(sp.Matrix([phi]), q, rates)[0], _rate(sp.Matrix([r]), q, rates)[0]
    v_upper, v_lower = _rate(upper, q, rates), _rate(lower, q, rates)
    kinetic = (
        _S["rail_inertia"] * turn**2 / 2
        + _S["pulley_mass"] * _square(v_upper) / 2
        + (_S["payload"] + _S["extra"]) * _square(v_lower) / 2
        + rope_kinetic(v_upper, v_lower)
    )
    stretch = length - _S["free_length"] + _S["stroke"]
    stretch_rate = _rate(sp.Matrix([stretch]), q, rates)[0]
    potential = (
        _S["stiffness"] * stretch**2 / 2
        + _S["pulley_mass"] * G * upper[2]
        + _S["rope_mass"] * G * (upper[2] + lower[2]) / 2
        + _S["extra"] * G * lower[2]  # the mechanism balances the payload's own weight
        + sum(_S[k] * u[i] ** 2 / 2 for i, k in enumerate(("kt", "kn", "kz")))
        - sum(_S[f] * u[i] for i, f in enumerate(("force_t", "force_n", "force_z")))
    )
    dissipation = (
        _S["damping"] * stretch_rate**2 / 2
        + _S["rail_viscous"] * (r * turn) ** 2 / 2
        + _S["pulley_viscous"] * slide**2 / 2
        + sum(_S[c] * u_rate[i] ** 2 / 2 for i, c in enumerate(("ct", "cn", "cz")))
        + node_dissipation
    )
    return derive(q, rates, kinetic, potential, dissipation, list(u))


def straight() -> str:
    """The paper's q = [x y l theta_x theta_y], the rope straight: its kinetic energy m/6 (v_u^2 + v_u v_l + v_l^2)."""
    q = x, y, length, theta_x, theta_y = sp.symbols("x y l theta_x theta_y")
    rates = sp.symbols("x_v y_v l_v theta_x_v theta_y_v")
    upper = sp.Matrix([x, y, _rail(x, y)[2]])
    rope = sp.Matrix(
        [sp.sin(theta_x), sp.cos(theta_x) * sp.sin(theta_y), -sp.cos(theta_x) * sp.cos(theta_y)],
    )
    lower = upper + length * rope

    def rope_kinetic(v_upper: Any, v_lower: Any) -> Any:
        return _S["rope_mass"] / 6 * (_square(v_upper) + (v_upper.T * v_lower)[0] + _square(v_lower))

    return _assemble(q, rates, upper, lower, length, rope_kinetic, sp.Integer(0))


def flexible(elements: int) -> str:
    """q = [x y, x_1 y_1 .. of the inner nodes, x_l y_l z_l]; nodes carry the mass of half an element on either side.

    Their heights divide the distance of pulley and payload evenly.
    """
    names = ["x", "y", *(f"{axis}{i}" for i in range(1, elements) for axis in "xy"), "xl", "yl", "zl"]
    q, rates = [sp.Symbol(name) for name in names], [sp.Symbol(f"{name}_v") for name in names]
    upper = sp.Matrix([q[0], q[1], _rail(q[0], q[1])[2]])
    lower = sp.Matrix(q[-3:])
    places = [upper]
    for i in range(1, elements):
        places.append(sp.Matrix([q[2 * i], q[2 * i + 1], upper[2] + (lower[2] - upper[2]) * sp.Rational(i, elements)]))
    places.append(lower)
    length = sum(sp.sqrt(_square(places[i + 1] - places[i])) for i in range(elements))
    speeds = [_rate(place, q, rates) for place in places]
    masses = [_S["rope_mass"] / elements * (1 if 0 < i < elements else sp.Rational(1, 2)) for i in range(elements + 1)]

    def rope_kinetic(_upper: Any, _lower: Any) -> Any:
        return sum(mass * _square(speed) / 2 for mass, speed in zip(masses, speeds, strict=True))

    across = sum(_square(speed[:2, :]) for speed in speeds[1:-1])
    return _assemble(q, rates, upper, lower, length, rope_kinetic, _S["node_damping"] * across / 2)


ELEMENTS = 4
DERIVED = pathlib.Path(__file__).with_name("derived")
DERIVATIONS: dict[str, Callable[[], str]] = {"straight": straight, "flexible": lambda: flexible(ELEMENTS)}


def digest() -> str:
    """What a kept derivation depends on: this file, and SymPy's release."""
    return hashlib.sha256(pathlib.Path(__file__).read_bytes() + sp.__version__.encode()).hexdigest()


def kept(name: str) -> str | None:
    """The kept derivation, None where this file or SymPy has changed since."""
    file = DERIVED / f"{name}.gz"
    text = gzip.decompress(file.read_bytes()).decode() if file.exists() else ""
    found, _, source = text.partition("\n")
    return source if found == digest() else None


def lagrangian(name: str) -> Lagrangian:
    """The system, from its kept derivation where there is one."""
    return Lagrangian(kept(name) or DERIVATIONS[name]())


if __name__ == "__main__":
    DERIVED.mkdir(exist_ok=True)
    for derived, make in DERIVATIONS.items():
        (DERIVED / f"{derived}.gz").write_bytes(gzip.compress(f"{digest()}\n{make()}".encode(), mtime=0))
