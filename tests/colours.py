"""How far apart colours are for people who see red, green or blue in another way."""

from itertools import combinations

import numpy as np
from matplotlib.colors import to_rgb

# Machado, Oliveira, Fernandes 2009, "A physiologically-based model for simulation of color vision deficiency", severity one.
SEEN = {
    "all colours": np.eye(3),
    "no red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "no green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "no blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])  # of linear sRGB


def lab(linear):
    """CIELAB of linear sRGB: a difference of 2 is just seen, one of 100 is that of black and white."""
    xyz = XYZ @ np.clip(linear, 0, 1) / XYZ.sum(1)
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def closest(colours):
    """The smallest difference of two of them, to whoever sees it smallest, and which they are."""
    found = []
    for seen, matrix in SEEN.items():
        for a, b in combinations(dict.fromkeys(colours), 2):
            linear = [
                np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
                for c in map(np.array, (to_rgb(a), to_rgb(b)))
            ]
            found.append((float(np.linalg.norm(lab(matrix @ linear[0]) - lab(matrix @ linear[1]))), a, b, seen))
    return min(found)
