"""A PID controller in the forms other tools use, converted exactly, see `fosopt.forms`.    [Astrom2006] Ch. 3"""

from __future__ import annotations

from math import inf, sqrt

from fosopt.control.pid import DIRECT, PID, SignalPath
from fosopt.errors import ModelError
from fosopt.forms import IdealForm, ParallelForm, SeriesForm

# Real zeros that coincide but for rounding are taken as equal.
_DOUBLE = 1e-12


def controller_of(form: ParallelForm | IdealForm | SeriesForm, path: SignalPath = DIRECT) -> PID:
    """The controller of a form, its gain the derivative one where there is one.

    Raises
    ------
    ModelError
        If all gains are zero, or a series form has a negative gain in parallel form.
    """
    terms = form if isinstance(form, ParallelForm) else form.parallel
    return PID(*terms.normalized, terms.filter_time, path)


def parallel_form(pid: PID) -> ParallelForm:
    """A controller in parallel form, its filters aside."""
    gain = float(pid.gain)
    return ParallelForm(gain * pid.kp, gain * pid.ki, gain * pid.kd, float(pid.rolloff_time))


def ideal_form(pid: PID) -> IdealForm:
    """A controller in ideal form, its filters aside.

    Raises
    ------
    ModelError
        If it has no proportional gain.
    """
    terms = parallel_form(pid)
    if not terms.proportional:
        raise ModelError("PID: without a proportional gain there is no ideal form; use the parallel form")
    return IdealForm(
        terms.proportional,
        terms.proportional / terms.integral if terms.integral else inf,
        terms.derivative / terms.proportional,
        terms.filter_time,
    )


def series_form(pid: PID) -> SeriesForm:
    """A controller in series form, its filters aside.    [Astrom2006] Ch. 3

    Raises
    ------
    ModelError
        If its zeros are complex: without a roll-off, if T_i < 4 T_d in ideal form.
    """
    terms = parallel_form(pid)
    lag = terms.filter_time if terms.derivative else 0.0
    # (1 + T_i s)(1 + T_d s) K/(T_i s (1 + T_f s)): the zeros of a s² + b s + k_i.
    a, b = terms.proportional * lag + terms.derivative, terms.proportional + terms.integral * lag
    if not terms.integral:
        if not terms.proportional:
            raise ModelError("PID: a derivative alone has no series form; use the parallel form")
        return SeriesForm(terms.proportional, inf, a / b, lag)
    square = b**2 - 4 * a * terms.integral
    if square < -_DOUBLE * b**2:
        ideal = (
            f"integral time {b / terms.integral:.6g} s and derivative time {a / b:.6g} s" if b else "no gain"
        )
        raise ModelError(
            f"PID: no series form, its zeros are complex ({ideal}; the integral time must be four times "
            "the derivative time or more); use the parallel or the ideal form"
        )
    root = sqrt(max(square, 0.0))
    integral_time = 0.5 * (b + root) / terms.integral
    return SeriesForm(terms.integral * integral_time, integral_time, 2 * a / (b + root) if a else 0.0, lag)


def form_lines(pid: PID) -> list[str]:
    """The controller in every form it has, one to a line."""
    terms = parallel_form(pid)
    lag = f", T_f = {terms.filter_time:.6g} s" if terms.filter_time and terms.derivative else ""
    lines = [
        f"parallel: k_p = {terms.proportional:.6g} N m/rad, k_i = {terms.integral:.6g} N m/(rad s), "
        f"k_d = {terms.derivative:.6g} N m s/rad{lag}"
    ]
    for name, convert in (("ideal", ideal_form), ("series", series_form)):
        try:
            form: IdealForm | SeriesForm = convert(pid)
        except ModelError as error:
            lines.append(f"{name}: {str(error).removeprefix('PID: ')}")
            continue
        integral = "" if form.integral_time == inf else f", T_i = {form.integral_time:.6g} s"
        lines.append(
            f"{name}: K = {form.gain:.6g} N m/rad{integral}, T_d = {form.derivative_time:.6g} s{lag}"
        )
    return lines
