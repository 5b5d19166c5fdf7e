"""Poses as files have them."""
import numpy as np


def pose(value):
    """4x4 or 3x4 lists, or a TUM line tx ty tz qx qy qz qw."""
    if isinstance(value, str):
        numbers = np.array([float(x) for x in value.split()][-7:])
        t, q = numbers[:3], numbers[3:] / np.linalg.norm(numbers[3:])
        x, y, z, w = q
        R = np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                      [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                      [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])
    else:
        T = np.array(value, dtype=np.float64)
        if T.shape not in ((3, 4), (4, 4)):
            raise ValueError('it is not a 4x4 matrix')
        R, t = T[:3, :3], T[:3, 3]
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-4):
        raise ValueError('its rotation part is not a rotation')
    return R, t
