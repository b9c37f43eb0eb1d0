"""The plant's equations of motion and their integration, compiled by numba. One file: numba's cache checks no other.

Units are mm, N, t (tonne) and s, which agree: a force over a mass is an acceleration in mm/s2. Coordinates: rail angle
``phi`` about the shaft, pulley radius ``r`` along the rail, and the payload's displacement ``u`` from where the
mechanism prescribes it, along the mechanism's tangential, normal (outward) and vertical (up) axes. They span the same
configurations as the paper's q = [x y l theta_x theta_y], `hil.plant.coordinates` converts. Only an axis of finite
stiffness moves; the paper's mechanism is rigid on all three.

Drift, kick, drift: forces are taken at the middle of the step, so smooth motion is integrated to second order and
free motion keeps its energy. What depends on rates is taken at their mean over the step, found by repeating the kick
until nothing changes. Friction is an impulse found implicitly (Moreau), so that stick is exact standstill.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

import numba

from hil.plant.layout import (
    FLOOR_RADIAL,
    FLOOR_TANGENTIAL,
    FLOOR_VERTICAL,
    FORCE_NORMAL,
    FORCE_TANGENTIAL,
    FORCE_VERTICAL,
    HEIGHT,
    MASS,
    MECHANISM,
    RUN_OUT,
)

GRAVITY = 9806.65
KG = 1.0e-3
_SWEEPS = 40
"""Most sweeps over rail and pulley, whose frictions depend on each other; two suffice if their inertia is uncoupled."""
_PASSES = 12
"""Most passes of the kick; three are usual."""
_SETTLED, _ROUNDING = 1.0e-12, 1.0e-15
"""A kick has settled when it changes by less than this: relative to itself, relative to the rates."""
_LEAST_PAYLOAD = 0.1
"""Share of the payload's mass that always stays: without mass a free axis has no equation of motion."""
_SHORTEST = 1.0e-9
"""mm, shortest element: a direction needs a length."""

_STILL = (0.0, 0.0, 0.0)

_Function = TypeVar("_Function", bound=Callable[..., Any])
_jit: Callable[[_Function], _Function] = numba.njit(cache=True, error_model="numpy")


@_jit
def profile(inputs: Any, channel: int, at: float) -> tuple[float, float, float]:
    """Value, first and second derivative of a channel: cubic segments plus tones."""
    segments, spans, tones, tone_spans, cursor = inputs
    value = rate = curvature = 0.0
    first, after = spans[channel]
    if after > first:
        i = cursor[channel]
        while i + 1 < after and segments[i + 1, 0] <= at:
            i += 1
        while i > first and segments[i, 0] > at:
            i -= 1
        cursor[channel] = i
        value = segments[i, 1]
        d = at - segments[i, 0]
        if d >= 0.0:
            c1, c2, c3 = segments[i, 2], segments[i, 3], segments[i, 4]
            value += d * (c1 + d * (c2 + d * c3))
            rate = c1 + d * (2.0 * c2 + 3.0 * d * c3)
            curvature = 2.0 * c2 + 6.0 * d * c3
    first, after = tone_spans[channel]
    for j in range(first, after):
        if tones[j, 3] <= at < tones[j, 4]:
            amplitude, omega = tones[j, 0], tones[j, 1]
            angle = omega * (at - tones[j, 3]) + tones[j, 2]
            sine = amplitude * math.sin(angle)
            value += sine
            rate += amplitude * omega * math.cos(angle)
            curvature -= omega * omega * sine
    return value, rate, curvature


@_jit
def in_use(inputs: Any) -> int:
    """Bit n is set when channel n is not empty; calling ``profile`` for the empty ones would take half the time."""
    spans, tone_spans = inputs[1], inputs[3]
    used = 0
    for channel in range(len(spans)):
        if spans[channel, 1] > spans[channel, 0] or tone_spans[channel, 1] > tone_spans[channel, 0]:
            used |= 1 << channel
    return used


@_jit
def screw_error(p: Any, motor: float) -> float:
    """Ripple: addition of the screw to the stroke within each turn."""
    return p.ripple * math.sin(2.0 * math.pi * motor / p.screw_lead) if p.ripple > 0.0 else 0.0


@_jit
def cylinder(p: Any, x: Any, h: float, command: float, braked: bool) -> None:
    """``ds/dt = v``, ``tau dv/dt = sat(u) - v`` with the lag exact, then the errors of screw and nut."""
    if braked:
        x.motor_speed = 0.0
    else:
        u = 0.0 if abs(command) < p.dead_band else min(max(command, -p.drive_speed), p.drive_speed)
        v = x.motor_speed
        reached = u + (v - u) * p.lag_decay
        if abs(reached - v) <= p.drive_acceleration * h:
            motor = x.motor + u * h + (v - reached) * p.lag
        else:
            reached = v + math.copysign(p.drive_acceleration * h, reached - v)
            motor = x.motor + 0.5 * (v + reached) * h
        motor += x.yielding * h
        if motor <= p.stroke_low or motor >= p.stroke_high:
            motor = min(max(motor, p.stroke_low), p.stroke_high)
            reached = 0.0
        x.motor = motor
        x.motor_speed = reached
    if p.backlash > 0.0:  # the load seats the nut on one flank; without load it has its play
        if x.tension > p.seating_load:
            x.play -= x.play * min(1.0, h / p.seating_time)
        else:
            x.play = min(max(x.play + x.motor_before - x.motor, 0.0), p.backlash)
    x.motor_before = x.motor
    x.stroke = x.motor + x.play + screw_error(p, x.motor)


@_jit
def stribeck(speed: float, static: float, dynamic: float, transition: float) -> float:
    """Friction coefficient: static at rest, falling to dynamic over the Stribeck speed."""
    ratio = speed / transition
    return dynamic + (static - dynamic) * math.exp(-ratio * ratio)


@_jit
def chain(
    nodes: Any, count: int, ax: float, ay: float, bx: float, by: float, drop: float, pulls: Any
) -> tuple[float, float]:
    """Length of the rope as ``count`` elements from (ax, ay) down to (bx, by), and its elements' mean cosine.

    ``nodes`` holds the inner nodes' horizontal place and speed; they share the vertical distance evenly, so their
    displacement from the straight line is the paper's ``N q_e`` (equation 2). ``pulls[i]`` becomes the horizontal part
    of element i's direction.
    """
    height = drop / count
    length = cosines = 0.0
    for i in range(count):
        end_x = nodes[i, 0] if i < count - 1 else bx
        end_y = nodes[i, 1] if i < count - 1 else by
        ex, ey = end_x - ax, end_y - ay
        element = max(math.sqrt(ex * ex + ey * ey + height * height), _SHORTEST)
        pulls[i, 0] = ex / element
        pulls[i, 1] = ey / element
        cosines += height / element
        length += element
        ax, ay = end_x, end_y
    return length, cosines / count


@_jit
def pull(p: Any, stretch: float, rate: float, drag: float) -> float:
    """Tension: spring and rope in series (equation 17) with damping ``D_l`` (equation 14); a rope cannot push.

    ``rate`` is the rate without tension; ``drag`` is the damping times what a newton of tension takes off that rate.
    """
    return max(0.0, p.stiffness * stretch + p.damping * rate) / (1.0 + drag) if stretch > 0.0 else 0.0


@_jit
def step(  # noqa: PLR0912, PLR0915 - equation (15) in one piece; parts would hand each other thirty numbers
    p: Any,
    x: Any,
    nodes: Any,
    pulls: Any,
    inputs: Any,
    used: int,
    t: float,
    h: float,
    command: float,
    braked: bool,
) -> None:
    """One step of ``h`` from ``t``: equation (15), M q'' + D q' + C q' + g = tau, in the coordinates named above.

    ``used`` is ``in_use(inputs)``.
    """
    half = 0.5 * h
    stroke = x.stroke
    cylinder(p, x, h, command, braked)
    stroke_rate = (x.stroke - stroke) / h
    stroke = 0.5 * (stroke + x.stroke)

    # drift to the middle of the step
    phi = x.phi + half * x.phi_rate
    r = x.r + half * x.r_rate
    ut = x.ut + half * x.ut_rate
    un = x.un + half * x.un_rate
    uz = x.uz + half * x.uz_rate
    count = int(p.elements)
    last = count - 1
    for i in range(last):
        nodes[i, 0] += half * nodes[i, 2]
        nodes[i, 1] += half * nodes[i, 3]

    # the prescribed motion there
    middle = t + half
    psi, omega, alpha = profile(inputs, MECHANISM, middle) if used & 1 << MECHANISM else _STILL
    high, high_rate, high_acceleration = profile(inputs, HEIGHT, middle) if used & 1 << HEIGHT else _STILL
    gx, gx_rate, gx_acceleration = profile(inputs, FLOOR_RADIAL, middle) if used & 1 << FLOOR_RADIAL else _STILL
    gy, gy_rate, gy_acceleration = profile(inputs, FLOOR_TANGENTIAL, middle) if used & 1 << FLOOR_TANGENTIAL else _STILL
    gz, gz_rate, gz_acceleration = profile(inputs, FLOOR_VERTICAL, middle) if used & 1 << FLOOR_VERTICAL else _STILL
    level, level_slope, level_bend = profile(inputs, RUN_OUT, phi) if used & 1 << RUN_OUT else _STILL
    force_t = profile(inputs, FORCE_TANGENTIAL, middle)[0] if used & 1 << FORCE_TANGENTIAL else 0.0
    force_n = profile(inputs, FORCE_NORMAL, middle)[0] if used & 1 << FORCE_NORMAL else 0.0
    force_z = profile(inputs, FORCE_VERTICAL, middle)[0] if used & 1 << FORCE_VERTICAL else 0.0
    extra = profile(inputs, MASS, middle)[0] * KG if used & 1 << MASS else 0.0
    extra = max(extra, (_LEAST_PAYLOAD - 1.0) * p.payload_mass)
    payload = p.payload_mass + extra

    # masses: T_l of equations (8) to (10) for a straight rope; for a flexible one lumped at its nodes, which move
    # across on their own and vertically with its ends
    node = p.rope_mass / count
    if count == 1:
        end = end_z = p.rope_mass / 3.0
        m_cross = m_cross_z = p.rope_mass / 6.0
    else:
        end, m_cross = 0.5 * node, 0.0
        end_z = p.rope_mass * (1.0 / 3.0 + 1.0 / (6.0 * count * count))
        m_cross_z = p.rope_mass * (1.0 - 1.0 / (count * count)) / 6.0
    m_upper, m_upper_z = p.pulley_mass + end, p.pulley_mass + end_z
    m_lower, m_lower_z = payload + end, payload + end_z

    # geometry of equation (2): pulley, payload and the rope between them
    c, s = math.cos(phi), math.sin(phi)
    cm, sm = math.cos(psi), math.sin(psi)
    out = p.radius + un
    upper_x = p.eccentricity_x + gx + r * c
    upper_y = p.eccentricity_y + gy + r * s
    lower_x = out * cm - ut * sm
    lower_y = out * sm + ut * cm
    drop = p.rope_length + level + p.rail_slope * (r - p.radius) + gz - high - uz
    length, cosine = chain(nodes, count, upper_x, upper_y, lower_x, lower_y, drop, pulls)
    stretch = length - p.free_length + stroke
    decay = bends = 0.0
    if last > 0:
        for i in range(last):
            ex, ey = pulls[i + 1, 0] - pulls[i, 0], pulls[i + 1, 1] - pulls[i, 1]
            bends += ex * ex + ey * ey
        # a jolt beyond the range checked for this step: nodes too fast for the step move as if they were heavier
        shortest = max(abs(drop) / count, _SHORTEST)
        node = max(node, h * h * p.stiffness * (4.0 * max(0.0, stretch) / shortest + bends))
        decay = half * p.node_damping / node

    # inertia of the pair (phi, r), the payload's free axes eliminated: M of equation (15)
    # (t, n) of the mechanism is (t ct + n st, n ct - t st) along and across the rail's own tangent
    ct, st = math.cos(psi - phi), math.sin(psi - phi)
    free_t, free_n, free_z = p.tangential_free, p.normal_free, p.vertical_free
    e_t = m_lower + half * p.tangential_damping  # the mechanism's damping by the trapezium rule
    e_n = m_lower + half * p.normal_damping
    e_z = m_lower_z + half * p.vertical_damping
    share_t, share_n = free_t * m_cross * m_cross / e_t, free_n * m_cross * m_cross / e_n
    up_z = m_upper_z - free_z * m_cross_z * m_cross_z / e_z
    j_phi_z, j_r_z = level_slope, p.rail_slope
    a11 = p.rail_inertia + r * r * (m_upper - share_t * ct * ct - share_n * st * st) + j_phi_z * j_phi_z * up_z
    a22 = (m_upper - share_t * st * st - share_n * ct * ct) + j_r_z * j_r_z * up_z
    a12 = r * (share_t - share_n) * st * ct + j_phi_z * j_r_z * up_z
    # viscous part (D of equation (15)) by the trapezium rule
    d1, d2 = half * p.rail_viscous * r * r, half * p.pulley_viscous
    e11, e22 = a11 + d1, a22 + d2

    # speed of shortening per N s of the tension's impulse, on which the axial damping acts back; an upper bound for the
    # ends: it makes the passes below converge and does not change their result
    mobility = (pulls[0, 0] * pulls[0, 0] + pulls[0, 1] * pulls[0, 1]) / m_upper
    mobility += (pulls[last, 0] * pulls[last, 0] + pulls[last, 1] * pulls[last, 1]) * max(free_t, free_n) / m_lower
    mobility += cosine * cosine * (free_z / m_lower_z + j_phi_z * j_phi_z / a11 + j_r_z * j_r_z / a22)
    if last > 0:
        mobility += bends / (node * (1.0 + decay))
    drag = half * p.damping * mobility

    phi_rate, r_rate = x.phi_rate, x.r_rate
    ut_rate, un_rate, uz_rate = x.ut_rate, x.un_rate, x.uz_rate
    friction1 = h * abs(r) * stribeck(r * phi_rate, p.rail_static, p.rail_dynamic, p.rail_stribeck)
    friction2 = h * stribeck(r_rate, p.pulley_static, p.pulley_dynamic, p.pulley_stribeck)
    weight = (p.pulley_mass + 0.5 * p.rope_mass) * GRAVITY
    # forces on the payload that do not depend on the kick; the mechanism carries the payload's own weight
    given_t = force_t - p.tangential_stiffness * ut - p.tangential_damping * ut_rate
    given_n = force_n - p.normal_stiffness * un - p.normal_damping * un_rate
    given_z = force_z - p.vertical_stiffness * uz - p.vertical_damping * uz_rate
    given_z -= (extra + 0.5 * p.rope_mass) * GRAVITY
    floor_t, floor_r = gy_acceleration * c - gx_acceleration * s, gx_acceleration * c + gy_acceleration * s
    new_phi, new_r = phi_rate, r_rate
    new_t, new_n, new_z = ut_rate, un_rate, uz_rate
    tension = 0.0
    smallest = math.inf
    for _ in range(_PASSES):
        # rates in the middle of the step: the old ones first, then the mean of old and new
        was_phi, was_r, was_t, was_n, was_z, was_tension = new_phi, new_r, new_t, new_n, new_z, tension
        w, v = 0.5 * (phi_rate + new_phi), 0.5 * (r_rate + new_r)
        vt, vn, vz = 0.5 * (ut_rate + new_t), 0.5 * (un_rate + new_n), 0.5 * (uz_rate + new_z)
        upper_vx = gx_rate + v * c - r * w * s
        upper_vy = gy_rate + v * s + r * w * c
        lower_vt, lower_vn = vt + omega * out, vn - omega * ut
        lower_vx, lower_vy = lower_vn * cm - lower_vt * sm, lower_vn * sm + lower_vt * cm
        drop_rate = level_slope * w + p.rail_slope * v + gz_rate - high_rate - vz
        if last == 0:
            along = pulls[0, 0] * (lower_vx - upper_vx) + pulls[0, 1] * (lower_vy - upper_vy)
        else:
            along = pulls[last, 0] * lower_vx + pulls[last, 1] * lower_vy
            along -= pulls[0, 0] * upper_vx + pulls[0, 1] * upper_vy
            for i in range(last):
                ex, ey = pulls[i + 1, 0] - pulls[i, 0], pulls[i + 1, 1] - pulls[i, 1]
                impulse = half * was_tension / node
                along -= (ex * (nodes[i, 2] + impulse * ex) + ey * (nodes[i, 3] + impulse * ey)) / (1.0 + decay)
        rate = along + cosine * drop_rate + stroke_rate
        # implicit in the damping: the last pass's tension changed the rate by -mobility h / 2 per newton
        tension = pull(p, stretch, rate + half * mobility * was_tension, drag)

        # forces of the rope on pulley (rail's frame) and payload (mechanism's frame): g of equation (15)
        up_t = tension * (-pulls[0, 0] * s + pulls[0, 1] * c)
        up_r = tension * (pulls[0, 0] * c + pulls[0, 1] * s)
        load = tension * cosine
        low_t = given_t - tension * (-pulls[last, 0] * sm + pulls[last, 1] * cm)
        low_n = given_n - tension * (pulls[last, 0] * cm + pulls[last, 1] * sm)
        low_z = given_z + load

        # accelerations that come without phi'', r'', u'': C q' of equation (15), and the prescribed ones
        bu_t = 2.0 * v * w + floor_t
        bu_r = -r * w * w + floor_r
        bu_z = level_bend * w * w + gz_acceleration
        bl_t = 2.0 * omega * vn + alpha * out - omega * omega * ut
        bl_n = -2.0 * omega * vt - alpha * ut - omega * omega * out
        bl_z = high_acceleration

        # right hand side for (phi, r): forces, less the inertia forces of those accelerations
        bu_mt = bu_t * ct - bu_r * st  # in the mechanism's frame
        bu_mn = bu_t * st + bu_r * ct
        own_t = free_t * (low_t - m_cross * bu_mt - m_lower * bl_t) / e_t
        own_n = free_n * (low_n - m_cross * bu_mn - m_lower * bl_n) / e_n
        own_z = free_z * (low_z - m_cross_z * bu_z - m_lower_z * bl_z) / e_z
        rest_t, rest_n = bl_t + own_t, bl_n + own_n
        push_t = up_t - m_upper * bu_t - m_cross * (rest_t * ct + rest_n * st)
        push_r = up_r - m_upper * bu_r - m_cross * (rest_n * ct - rest_t * st)
        push_z = -load - weight - m_upper_z * bu_z - m_cross_z * (bl_z + own_z)
        q1 = r * push_t + j_phi_z * push_z
        q2 = push_r + j_r_z * push_z

        # friction as an implicit impulse
        b1 = a11 * phi_rate + a12 * r_rate - d1 * phi_rate + h * q1
        b2 = a12 * phi_rate + a22 * r_rate - d2 * r_rate + h * q2
        normal = abs(load) + p.dead_load  # the rail guides the pulley from above and below
        limit1, limit2 = friction1 * normal, friction2 * normal
        new_phi, new_r = phi_rate, r_rate
        for _sweep in range(_SWEEPS):
            before_phi, before_r = new_phi, new_r
            wanted = b1 - a12 * new_r
            new_phi = math.copysign(max(0.0, abs(wanted) - limit1), wanted) / e11
            wanted = b2 - a12 * new_phi
            new_r = math.copysign(max(0.0, abs(wanted) - limit2), wanted) / e22
            if new_phi == before_phi and new_r == before_r:
                break

        # the payload's free axes follow
        phi_kick, r_kick = new_phi - phi_rate, new_r - r_rate
        new_t = ut_rate + h * own_t - free_t * m_cross * (r * phi_kick * ct - r_kick * st) / e_t
        new_n = un_rate + h * own_n - free_n * m_cross * (r * phi_kick * st + r_kick * ct) / e_n
        new_z = uz_rate + h * own_z - free_z * m_cross_z * (j_phi_z * phi_kick + j_r_z * r_kick) / e_z

        changed = abs(r * (new_phi - was_phi)) + abs(new_r - was_r)
        changed += abs(new_t - was_t) + abs(new_n - was_n) + abs(new_z - was_z)
        kick = abs(r * phi_kick) + abs(r_kick) + abs(new_t - ut_rate) + abs(new_n - un_rate) + abs(new_z - uz_rate)
        rates = abs(r * new_phi) + abs(new_r) + abs(new_t) + abs(new_n) + abs(new_z)
        if changed <= _SETTLED * kick + _ROUNDING * rates and abs(tension - was_tension) <= _SETTLED * tension:
            break
        if changed > 10.0 * smallest:  # rotating faster than the step resolves: repeating makes it worse
            break
        smallest = min(smallest, changed)

    x.phi_acceleration = (new_phi - phi_rate) / h
    x.r_acceleration = (new_r - r_rate) / h
    x.ut_acceleration = (new_t - ut_rate) / h
    x.un_acceleration = (new_n - un_rate) / h
    x.uz_acceleration = (new_z - uz_rate) / h
    x.tension = tension

    # kick the rope's nodes, drift through the second half
    for i in range(last):
        for axis in range(2):
            old = nodes[i, 2 + axis]
            force = tension * (pulls[i + 1, axis] - pulls[i, axis])
            nodes[i, 2 + axis] = (old * (1.0 - decay) + h * force / node) / (1.0 + decay)
            nodes[i, axis] += half * nodes[i, 2 + axis]
    x.phi = phi + half * new_phi
    x.r = r + half * new_r
    x.ut = ut + half * new_t
    x.un = un + half * new_n
    x.uz = uz + half * new_z
    x.phi_rate, x.r_rate = new_phi, new_r
    x.ut_rate, x.un_rate, x.uz_rate = new_t, new_n, new_z


@_jit
def run(
    parameters: Any,
    state: Any,
    nodes: Any,
    pulls: Any,
    inputs: Any,
    t: float,
    h: float,
    count: int,
    command: float,
    braked: bool,
) -> None:
    """``count`` steps of ``h`` from ``t`` under one command; both are whole nanoseconds."""
    p, x = parameters[0], state[0]
    used = in_use(inputs)
    t_ns, h_ns = round(t * 1e9), round(h * 1e9)
    for i in range(count):  # times counted in ns are the same to the last bit, wherever the run began
        step(p, x, nodes, pulls, inputs, used, (t_ns + i * h_ns) * 1e-9, h, command, braked)


@_jit
def observe(
    parameters: Any, state: Any, nodes: Any, pulls: Any, inputs: Any, view: Any, t: float, ahead: float, braked: bool
) -> None:
    """Write the view of the state ``ahead`` seconds after its time ``t`` into ``view``."""
    p, x, seen = parameters[0], state[0], view[0]
    now = t + ahead
    count = int(p.elements)
    psi, omega, alpha = profile(inputs, MECHANISM, now)
    high, high_rate, _ = profile(inputs, HEIGHT, now)
    gx, gx_rate, gx_acceleration = profile(inputs, FLOOR_RADIAL, now)
    gy, gy_rate, gy_acceleration = profile(inputs, FLOOR_TANGENTIAL, now)
    gz, gz_rate, _ = profile(inputs, FLOOR_VERTICAL, now)
    phi, r = x.phi + ahead * x.phi_rate, x.r + ahead * x.r_rate
    ut, un, uz = x.ut + ahead * x.ut_rate, x.un + ahead * x.un_rate, x.uz + ahead * x.uz_rate
    level, level_slope, _ = profile(inputs, RUN_OUT, phi)
    c, s = math.cos(phi), math.sin(phi)
    cm, sm = math.cos(psi), math.sin(psi)
    out = p.radius + un
    upper_x, upper_y = p.eccentricity_x + gx + r * c, p.eccentricity_y + gy + r * s
    lower_x, lower_y = out * cm - ut * sm, out * sm + ut * cm
    drop = p.rope_length + level + p.rail_slope * (r - p.radius) + gz - high - uz
    length, cosine = chain(nodes, count, upper_x, upper_y, lower_x, lower_y, drop, pulls)
    stroke_rate = 0.0 if braked else x.motor_speed + x.yielding
    stroke = x.stroke + ahead * stroke_rate
    stretch = length - p.free_length + stroke

    upper_vx = gx_rate + x.r_rate * c - r * x.phi_rate * s
    upper_vy = gy_rate + x.r_rate * s + r * x.phi_rate * c
    lower_vt, lower_vn = x.ut_rate + omega * out, x.un_rate - omega * ut
    last = count - 1
    along = -pulls[0, 0] * upper_vx - pulls[0, 1] * upper_vy
    for i in range(last):
        along += (pulls[i, 0] - pulls[i + 1, 0]) * nodes[i, 2] + (pulls[i, 1] - pulls[i + 1, 1]) * nodes[i, 3]
    along += pulls[last, 0] * (lower_vn * cm - lower_vt * sm) + pulls[last, 1] * (lower_vn * sm + lower_vt * cm)
    along += cosine * (level_slope * x.phi_rate + p.rail_slope * x.r_rate + gz_rate - high_rate - x.uz_rate)

    # equation (2), solved for the angles: the straight line from pulley to payload
    dx, dy = lower_x - upper_x, lower_y - upper_y
    across, outwards = dy * c - dx * s, dx * c + dy * s
    seen.tension = pull(p, stretch, along + stroke_rate, 0.0)
    seen.vertical = seen.tension * cosine
    seen.tangential = math.atan2(across, math.sqrt(outwards * outwards + drop * drop))
    seen.normal = math.atan2(outwards, drop)
    seen.stroke, seen.speed = stroke, stroke_rate
    seen.mechanism, seen.rail, seen.pulley = psi, phi, r
    seen.height = high + uz
    seen.length, seen.stretch = length, stretch
    seen.upper_tangential = (
        r * x.phi_acceleration + 2.0 * x.r_rate * x.phi_rate + gy_acceleration * c - gx_acceleration * s
    )
    seen.upper_normal = x.r_acceleration - r * x.phi_rate * x.phi_rate + gx_acceleration * c + gy_acceleration * s
    at = x.ut_acceleration + 2.0 * omega * x.un_rate + alpha * out - omega * omega * ut
    an = x.un_acceleration - 2.0 * omega * x.ut_rate - alpha * ut - omega * omega * out
    ct, st = math.cos(psi - phi), math.sin(psi - phi)
    seen.lower_tangential = at * ct + an * st
    seen.lower_normal = an * ct - at * st
    seen.drop = drop
    seen.lower_x, seen.lower_y = lower_x, lower_y
    seen.upper_x, seen.upper_y = upper_x, upper_y
