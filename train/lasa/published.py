"""Published numbers to compare with.

From the result files of the LPV-DS program (github.com/nbfigueroa/ds-opt, results/stats_all_test.fig and
seds_stats_all.mat, 2018).
"""

PUBLISHED = {
    "SEDS": (6.34, 6.71, 0.099, 0.062, 3954, 7411),
    "LPV-DS, EM-GMM, O1 (A + Aᵀ < 0)": (6.64, 3.18, 0.106, 0.067, 2974, 2762),
    "LPV-DS, EM-GMM, O2 (P free)": (6.52, 5.94, 0.079, 0.042, 1990, 2136),
    "LPV-DS, EM-GMM, O3 (P given)": (6.58, 5.82, 0.081, 0.046, 2180, 2708),
    "LPV-DS, PC-GMM, O1 (A + Aᵀ < 0)": (5.79, 1.90, 0.097, 0.067, 2941, 2587),
    "LPV-DS, PC-GMM, O2 (P free)": (5.19, 1.70, 0.062, 0.034, 1749, 1608),
    "LPV-DS, PC-GMM, O3 (P given)": (5.28, 1.71, 0.063, 0.034, 1751, 1573),
}
"""Test set of the 26 motions, mean and standard deviation: RMSE [mm/s], ė, DTWD [mm]."""

PUBLISHED_SEDS = {
    "Angle": 9.24,
    "BendedLine": 8.25,
    "CShape": 7.51,
    "DoubleBendedLine": 2.96,
    "GShape": 4.32,
    "JShape": 5.06,
    "JShape_2": 13.94,
    "Khamesh": 5.34,
    "LShape": 7.07,
    "Leaf_1": 5.81,
    "Leaf_2": 3.35,
    "Line": 14.41,
    "NShape": 9.60,
    "PShape": 3.62,
    "RShape": 4.84,
    "Saeghe": 5.39,
    "Sharpc": 7.29,
    "Sine": 2.62,
    "Snake": 5.02,
    "Spoon": 2.52,
    "Sshape": 7.81,
    "Trapezoid": 4.43,
    "WShape": 5.65,
    "Worm": 2.19,
    "Zshape": 10.70,
    "heee": 6.01,
}
"""RMSE [mm/s] of the published SEDS fits by motion, test set, mean of 10 runs."""
