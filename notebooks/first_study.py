# %% [markdown]
# # A first co-design
#
# A study is a problem: minimize structural mass and jitter over the areas of a truss and the gains of its mirror's
# loop. Here it is posed, looked at, composed with CasADi, and solved.

# %%
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np

import fosopt

ROOT = Path(__file__).resolve().parents[1] if "__file__" in globals() else Path("..")
study = fosopt.load_study(ROOT / "studies" / "quickstart.yaml")
problem = fosopt.build_problem(study)
design = problem.evaluate(problem.start)

# %% [markdown]
# The design at the start: stable, with a jitter far above what the loop could reach.

# %%
print(f"spectral abscissa {design.value('spectral_abscissa'):.4f} 1/s")
print(f"jitter            {1e6 * design.value('jitter_total'):.2f} urad")
print(f"modulus margin    {design.value('modulus_margin'):.3f}")

# %% [markdown]
# Which modes does the mirror disturb? The effective modal reaction inertias sum to one; the mirror mode holds most.

# %%
coupled = design.coupled
share = coupled.effective_modal_reaction_inertia
for k in np.argsort(share)[::-1][:5]:
    print(f"mode {k + 1:2d} at {coupled.natural_frequency[k] / (2 * np.pi):7.2f} Hz: {share[k]:.2e}")
print(f"sum {share.sum():.15f}")

# %% [markdown]
# Metrics are CasADi functions with exact derivatives: compose what you like.

# %%
metrics = problem.metric_function("structural_mass", "jitter_total")
x = ca.MX.sym("x", problem.size)
m = metrics(x)
cost = ca.Function("cost", [x], [ca.log(m[0]) + ca.log(m[1])])
slope = ca.Function("slope", [x], [ca.gradient(cost(x), x)])
print("d cost / d variables:", np.round(slope(problem.start).full().ravel(), 4))

# %% [markdown]
# And the whole study: a run directory with the front, the designs and a report.

# %%
with tempfile.TemporaryDirectory() as folder:
    run = fosopt.run_study(study, Path(folder) / "run")
for point in run["points"]:
    mass, jitter = point["metrics"]["structural_mass"], point["metrics"]["jitter_total"]
    print(
        f"{point['label']:24s} {mass:8.2f} kg {1e6 * jitter:9.3f} urad  {point['status']}, verified {point['verified']}"
    )
