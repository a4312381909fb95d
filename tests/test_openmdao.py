"""The component for OpenMDAO: its own check of partial derivatives, its optimum, its refusals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import openmdao.api as om
import pytest

import fosopt
from fosopt.errors import ModelError
from fosopt.openmdao import CodesignComponent

STUDY = Path(__file__).parents[1] / "studies" / "quickstart.yaml"


@pytest.fixture(scope="module")
def problem():
    return fosopt.build_problem(fosopt.load_study(STUDY))


def model_of(problem, **options) -> om.Problem:
    model = om.Problem(reports=None)
    model.model.add_subsystem("optics", CodesignComponent(problem=problem, **options), promotes=["*"])
    return model


def test_openmdao_s_own_check_finds_the_partial_derivatives_exact(problem):
    model = model_of(
        problem, metrics=["jitter_total", "modulus_margin", "1e6 * jitter_total + structural_mass"]
    )
    model.setup()
    model.run_model()
    checks = model.check_partials(
        out_stream=None, method="fd", form="central", step=1e-5, step_calc="rel_avg"
    )
    for (output, variable), check in checks["optics"].items():
        exact, differences = check["J_fwd"], check["J_fd"]
        # Central differences of a relative step h leave h², and rounding over h.
        scale = np.abs(exact).max() or 1.0
        assert np.abs(exact - differences).max() <= 1e-6 * scale, (output, variable)


def test_values_are_those_of_the_problem(problem):
    model = model_of(problem, metrics=["structural_mass", "2 * jitter_total + mirror_inertia"])
    model.setup()
    model.run_model()
    evaluation = problem.evaluate(problem.start)
    assert model.get_val("structural_mass")[0] == evaluation.value("structural_mass")
    expected = 2 * evaluation.value("jitter_total") + evaluation.value("mirror_inertia")
    assert model.get_val("2_jitter_total_mirror_inertia")[0] == pytest.approx(expected, rel=1e-15)


def test_by_default_the_outputs_are_those_of_objectives_and_constraints(problem):
    component = CodesignComponent(problem=problem)
    model = om.Problem(reports=None)
    model.model.add_subsystem("optics", component, promotes=["*"])
    model.setup()
    texts = [e.text for e in problem.objectives] + [c.name for c in problem.constraints]
    assert component._names == list(dict.fromkeys(texts))


def test_an_unstable_loop_is_an_analysis_error(problem):
    model = model_of(problem, metrics=["jitter_total"])
    model.setup()
    model.set_val("ki", 1e9)
    with pytest.raises(om.AnalysisError, match="unstable"):
        model.run_model()


def test_a_variable_alone_is_no_metric(problem):
    name = problem.variables[-1].name
    with pytest.raises(ModelError, match="no variable alone"):
        model_of(problem, metrics=[name]).setup()
