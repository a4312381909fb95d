# %% [markdown]
# # A model of one's own
#
# A finite-element program has given a table of modes at two grids, and a test two measured spectra. This notebook looks
# at them, judges a loop that was guessed, and designs a better one. Formats and units: `docs/own_model.md`.

# %%
import tempfile
from pathlib import Path

import numpy as np

import fosopt
from fosopt.units import HZ, URAD

ROOT = Path(__file__).resolve().parents[1] if "__file__" in globals() else Path("..")
study = fosopt.load_study(ROOT / "studies" / "own-model.yaml")
problem = fosopt.build_problem(study)
design = problem.evaluate(problem.start)

# %% [markdown]
# What came in: modes in mm and N, now in SI, with the mirror's mass on them and the hub held by its attitude loop.
# Do the lowest frequencies look like those of the program? The mirror's mass can only have lowered them.

# %%
modes = design.modes
print("frequencies [Hz]: ", np.round(modes.natural_frequency[:8] / HZ, 2))
print("damping ratios [%]:", np.round(100 * modes.damping_ratio[:8], 2))
print(
    f"structural mass {design.value('structural_mass'):.1f} kg, reference inertia at the mirror's port "
    f"{design.value('reference_inertia'):.4f} kg m^2"
)

# %% [markdown]
# Which modes will the mirror disturb? Those with the largest effective modal reaction inertia. A structural mode at
# 20 Hz, where the mirror has its own, shares it half and half: a number to take back to the finite-element model. The
# mode in the kilohertz is none of the file; it carries the residual flexibility of the modes that were left out.

# %%
coupled = design.coupled
share = coupled.effective_modal_reaction_inertia
for k in np.argsort(share)[::-1][:5]:
    print(f"mode {k + 1:2d} at {coupled.natural_frequency[k] / HZ:7.2f} Hz: {share[k]:.2e}")

# %% [markdown]
# The jitter budget of the guessed loop. Sources are independent: their jitter adds by squares.

# %%
SOURCES = [f"jitter_{each.name}" for each in study.disturbances]
for name in (*SOURCES, "jitter_total"):
    print(f"{name:22s} {design.value(name) / URAD:8.2f} urad")

# %% [markdown]
# And the loop that fosopt designs, with mirror inertia, crossover and two gains free. The run directory has the report,
# in which the cumulative jitter is drawn against the requirement line.

# %%
with tempfile.TemporaryDirectory() as folder:
    run = fosopt.run_study(study, Path(folder) / "run")
best = run["points"][-1]
for name in (*SOURCES, "jitter_total"):
    print(f"{name:22s} {best['metrics'][name] / URAD:8.2f} urad")
required = study.requirements["jitter_total"]
print(
    f"{best['status']}, verified {best['verified']}, jitter below {required / URAD:g} urad: "
    f"{best['metrics']['jitter_total'] < required}"
)

# %% [markdown]
# Would fewer modes have done? The same loop on the modes below a limit.

# %%
for limit in ("20 Hz", "60 Hz", "200 Hz"):
    fewer = fosopt.build_problem(
        fosopt.load_study(ROOT / "studies" / "own-model.yaml", [f"modes.below={limit}"])
    )
    there = fewer.evaluate(fewer.vector(best["variables"]))
    print(
        f"modes below {limit:>6s}: {there.modes.natural_frequency.size:2d} modes, "
        f"{there.value('jitter_total') / URAD:.3f} urad"
    )
