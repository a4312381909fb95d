"""Sums over modes and poles at very many points, as compiled loops.

Differences are taken as (base − pole) + shift, in this order, so that points close to a pole keep all digits of their
distance.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from fosopt.ops import Array, ComplexArray


@numba.njit(error_model="numpy", cache=True)
def modal_sums(
    first: ComplexArray, second: ComplexArray, constant: Array, base: ComplexArray, shift: ComplexArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Receptances Σ_k a_k/D_k and their slopes, and Σ_k D_k′/D_k, D_k = (s − p_k)(s − p_k′) at s = base + shift.

    A double pole at zero is no part of the last.

    Parameters
    ----------
    first, second
        (n,) poles of each mode [rad/s].
    constant
        (n, q) a, one column per pair of ports.

    Returns
    -------
    (q, m), (q, m), (m,)
        One column per point.
    """
    n, q = constant.shape
    m = base.size
    value, slope = np.zeros((q, m), dtype=np.complex128), np.zeros((q, m), dtype=np.complex128)
    logarithmic = np.zeros(m, dtype=np.complex128)
    for i in range(m):
        for k in range(n):
            x = (base[i] - first[k]) + shift[i]
            y = (base[i] - second[k]) + shift[i]
            d = x * y
            size = 1.0 / (d.real * d.real + d.imag * d.imag)
            inverse = complex(d.real * size, -d.imag * size)
            ratio = (x + y) * inverse
            if first[k] != 0.0:
                logarithmic[i] += ratio
            for p in range(q):
                part = constant[k, p] * inverse
                value[p, i] += part
                slope[p, i] -= part * ratio
    return value, slope, logarithmic


@numba.njit(error_model="numpy", cache=True)
def repulsion(
    base: ComplexArray,
    shift: ComplexArray,
    pair: NDArray[np.bool_],
    line: NDArray[np.intp],
    place: NDArray[np.intp],
) -> ComplexArray:
    """Σ_j 1/(p − p_j) over all other poles of the same line, and over the conjugates of pairs.

    Parameters
    ----------
    base, shift
        (l, m) poles base + shift of each line [rad/s].
    pair
        (m,) whether a pole stands for a conjugate pair.
    line, place
        (r,) of the poles p that are asked for.
    """
    total = np.zeros(line.size, dtype=np.complex128)
    for r in range(line.size):
        i, own = line[r], place[r]
        b, d = base[i, own], shift[i, own]
        for j in range(pair.size):
            if j != own:
                x = (b - base[i, j]) + (d - shift[i, j])
                size = 1.0 / (x.real * x.real + x.imag * x.imag)
                total[r] += complex(x.real * size, -x.imag * size)
            if pair[j]:
                x = (b - base[i, j].conjugate()) + (d - shift[i, j].conjugate())
                size = 1.0 / (x.real * x.real + x.imag * x.imag)
                total[r] += complex(x.real * size, -x.imag * size)
    return total
