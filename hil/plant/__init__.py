"""The full multi-body plant: rail, pulley, rope, mechanism and cylinder.

Where the equations of the paper (Wang et al.) are:

====== ========================================= =======================================================================
(1)    place of the lower lifting point          `coordinates`; `kernel.step`, geometry: the same in the plant's own
(2)    ... with the rope's shape ``N q_e``       `kernel.chain`: straight elements between nodes that move across
(3)    its velocity                              `coordinates` (as repaired); `kernel.step`, rates in the middle
(4)    (1) as vectors                            as (1)
(5)    rotation of the rope's frame              `kernel.step`: the elements' directions (``pulls``), no matrix
(6, 7) velocity of a point of the rope           `kernel.step`: linear between nodes
(8-10) kinetic energy of the rope                `kernel.step`, masses: m/3 and m/6, or lumped at nodes
(11)   elastic energy                            `kernel.pull` along; across, the tension of `kernel.chain` is all of it
(12)   potential energy                          `kernel.step`, weights; the mechanism carries the payload's own
(13)   kinetic energy of the rail                `kernel.step`, ``rail_inertia`` (the printed formula repeats (10))
(14)   damping: D_l; D_theta, friction           `kernel.pull`; `kernel.step`, viscous and ``stribeck``
(15)   M q'' + D q' + C q' + g = tau             `kernel.step`, in phi, r and u; judged by ``tests/plant/lagrangian.py``
(16)   error of the vertical component           `rigctl.metrics.tension_error.error_pct`, from ``Truth.vertical_n``
(17)   spring and rope in series                 `rigctl.config.rig_file.PlantSettings.stiffness_n_mm`
====== ========================================= =======================================================================

Symbols: for x, y, l, theta_x, theta_y see `coordinates`; the paper's theta(t), angle of the rail, is ``phi``, and
``psi`` is the mechanism's; k is ``stiffness``; m_l and m_e are ``rope_mass``; D_l is ``damping``; F_rz is ``vertical``;
v_p is the rate of channel ``HEIGHT``.
"""

from hil.plant.plant import Plant

__all__ = ["Plant"]
