"""Sums over modes and poles at very many points, as compiled loops.

Differences are taken as (base − pole) + shift, in this order, so that points close to a pole keep all digits of their
distance. Only the sums over what has been formed from them may be reordered, which is what makes the loops fast.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from fosopt.ops import Array, ComplexArray

_SUMS = {"reassoc", "contract", "arcp"}


@numba.njit(error_model="numpy", cache=True)
def _apart(base: float, pole: float, shift: float) -> float:
    """(base − pole) + shift in this order, whatever its caller may reorder."""
    return (base - pole) + shift


@numba.njit(fastmath=_SUMS, error_model="numpy", cache=True)
def modal_sums(
    first: ComplexArray,
    second: ComplexArray,
    constant: Array,
    linear: Array,
    base: ComplexArray,
    shift: ComplexArray,
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Receptances Σ_k (a_k + b_k s)/D_k and their slopes, and Σ_k D_k′/D_k, where D_k = (s − p_k)(s − p_k′).

    Points are s = base + shift. A double pole at zero is no part of the last sum.

    Parameters
    ----------
    first, second
        (n,) poles of each mode [rad/s].
    constant, linear
        (q, n) a and b, one row per pair of ports; no row at all where every b is zero.

    Returns
    -------
    (q, m), (q, m), (m,)
        One column per point.
    """
    q, n = constant.shape
    m = base.size
    value, slope = np.empty((q, m), dtype=np.complex128), np.empty((q, m), dtype=np.complex128)
    logarithmic = np.empty(m, dtype=np.complex128)
    real, imag, other_real, other_imag = (
        first.real.copy(),
        first.imag.copy(),
        second.real.copy(),
        second.imag.copy(),
    )
    moving = (first != 0.0).astype(np.float64)
    # Of each mode at one point: 1/D and its slope −D′/D².
    ur, ui, vr, vi = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for i in range(m):
        br, bi, dr, di = base[i].real, base[i].imag, shift[i].real, shift[i].imag
        lr = li = 0.0
        for k in range(n):
            xr, xi = _apart(br, real[k], dr), _apart(bi, imag[k], di)
            yr, yi = _apart(br, other_real[k], dr), _apart(bi, other_imag[k], di)
            er, ei = xr * yr - xi * yi, xr * yi + xi * yr
            size = 1.0 / (er * er + ei * ei)
            ir, ii = er * size, -ei * size
            tr, ti = xr + yr, xi + yi
            fr, fi = tr * ir - ti * ii, tr * ii + ti * ir
            lr += moving[k] * fr
            li += moving[k] * fi
            ur[k], ui[k] = ir, ii
            vr[k], vi[k] = fi * ii - fr * ir, -fr * ii - fi * ir
        logarithmic[i] = complex(lr, li)
        for c in range(q):
            ar = ai = sr = si = 0.0
            for k in range(n):
                w = constant[c, k]
                ar += w * ur[k]
                ai += w * ui[k]
                sr += w * vr[k]
                si += w * vi[k]
            value[c, i], slope[c, i] = complex(ar, ai), complex(sr, si)
        s = base[i] + shift[i]
        for c in range(linear.shape[0]):
            ar = ai = sr = si = 0.0
            for k in range(n):
                w = linear[c, k]
                ar += w * ur[k]
                ai += w * ui[k]
                sr += w * vr[k]
                si += w * vi[k]
            by_s = complex(ar, ai)
            value[c, i] += s * by_s
            slope[c, i] += s * complex(sr, si) + by_s
    return value, slope, logarithmic


@numba.njit(fastmath=_SUMS, error_model="numpy", cache=True)
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
    real, imag, by_real, by_imag = base.real.copy(), base.imag.copy(), shift.real.copy(), shift.imag.copy()
    total = np.empty(line.size, dtype=np.complex128)
    for r in range(line.size):
        i, own = line[r], place[r]
        b, c, d, e = real[i, own], imag[i, own], by_real[i, own], by_imag[i, own]
        tr = ti = 0.0
        for j in range(pair.size):
            x = _apart(b, real[i, j], d - by_real[i, j])
            y = _apart(c, imag[i, j], e - by_imag[i, j])
            size = 1.0 / (x * x + y * y) if j != own else 0.0
            tr += x * size
            ti -= y * size
            y = _apart(c, -imag[i, j], e + by_imag[i, j])
            size = 1.0 / (x * x + y * y) if pair[j] else 0.0
            tr += x * size
            ti -= y * size
        total[r] = complex(tr, ti)
    return total
