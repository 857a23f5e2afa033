"""Direction numbers of Sobol' sequences.

Source: Joe and Kuo (2008), Constructing Sobol sequences with better two-dimensional projections;
the first axes of their set new-joe-kuo-6.21201, which `scipy.stats.qmc` has too.
"""

import numpy as np
from numpy.typing import NDArray

BITS = 30
"""Binary digits of a coordinate."""

# fmt: off
_INITIAL = (
    (3, 1), (7, 1, 3), (11, 1, 3, 1), (13, 1, 1, 1), (19, 1, 1, 3, 3), (25, 1, 3, 5, 13),
    (37, 1, 1, 5, 5, 17), (41, 1, 1, 5, 5, 5), (47, 1, 1, 7, 11, 19), (55, 1, 1, 5, 1, 1),
    (59, 1, 1, 1, 3, 11), (61, 1, 3, 5, 5, 31), (67, 1, 3, 3, 9, 7, 49), (91, 1, 1, 1, 15, 21, 21),
    (97, 1, 3, 1, 13, 27, 49), (103, 1, 1, 1, 15, 7, 5), (109, 1, 3, 1, 15, 13, 25),
    (115, 1, 1, 5, 5, 19, 61), (131, 1, 3, 7, 11, 23, 15, 103), (137, 1, 3, 7, 13, 13, 15, 69),
    (143, 1, 1, 3, 13, 7, 35, 63), (145, 1, 3, 5, 9, 1, 25, 53), (157, 1, 3, 1, 13, 9, 35, 107),
    (167, 1, 3, 1, 5, 27, 61, 31), (171, 1, 1, 5, 11, 19, 41, 61), (185, 1, 3, 5, 3, 3, 13, 69),
    (191, 1, 1, 7, 13, 1, 19, 1), (193, 1, 3, 7, 5, 13, 19, 59), (203, 1, 1, 3, 9, 25, 29, 41),
    (211, 1, 3, 5, 13, 23, 1, 55), (213, 1, 3, 7, 3, 13, 59, 17), (229, 1, 3, 1, 3, 5, 53, 69),
    (239, 1, 1, 5, 5, 23, 33, 13), (241, 1, 1, 7, 7, 1, 61, 123), (247, 1, 1, 7, 9, 13, 61, 49),
    (253, 1, 3, 3, 5, 3, 55, 33), (285, 1, 3, 1, 15, 31, 13, 49, 245),
    (299, 1, 3, 5, 15, 31, 59, 63, 97), (301, 1, 3, 1, 11, 11, 11, 77, 249),
)
# fmt: on
"""For each axis but the first: a primitive polynomial as binary digits, and the first numbers."""

AXES = 1 + len(_INITIAL)
"""Most axes that there are numbers for."""


def direction_numbers(k: int) -> NDArray[np.int64]:
    """Return the binary digits (k, BITS, BITS) of the direction numbers, highest digit first.

    Parameters
    ----------
    k : int
        Number of axes, at most `AXES`.
    """
    numbers = [[1] * BITS]
    for polynomial, *initial in _INITIAL[: k - 1]:
        degree, of_axis = len(initial), list(initial)
        for j in range(degree, BITS):
            number = of_axis[j - degree]
            for i in range(1, degree + 1):
                if polynomial >> (degree - i) & 1:
                    number ^= of_axis[j - i] << i
            of_axis.append(number)
        numbers.append(of_axis)
    shifted = np.array(numbers[:k], dtype=np.int64) << np.arange(BITS)[::-1]
    digits: NDArray[np.int64] = shifted[:, :, None] >> np.arange(BITS)[::-1] & 1
    return digits
