"""The claim of section 7: what noise of the system does to learning."""

from __future__ import annotations

from train.paper.claims.base import Check, Claim, lower
from train.paper.measured.base import Setting, course, learned

SENSOR, PUSH = 0.02, 5.0  # m and N; the stiffness is at 10 to 20 N/m, the motion 12 m long


def noisy_trials(setting: Setting) -> list[Check]:
    """Where both force fields end that are learned from trials with and without noise, by what they cost without it."""
    checks = []
    for task in ("divergent_field", "half_plane_force"):
        calm, noisy = (
            course(learned(task, setting.runs, setting.seed, **noise))[-1]
            for noise in ({}, {"sensor_noise": SENSOR, "pushes": PUSH})
        )
        checks.append(lower(f"{task}, final cost, without noise below with it", calm, noisy))
    return checks


CLAIMS = [
    Claim(
        "system-noise",
        "7",
        "PI² assumes that the system has no noise but that of the exploration; perturbations in the trials do harm.",
        f"Learned from trials with sensors that are {SENSOR:g} m wrong and a push of {PUSH:g} N, both force fields end higher.",
        noisy_trials,
    ),
]
