# %% [markdown]
# # A front with certificates
#
# An optimizer finds designs; a certificate says how much better another could be. Here a truss of six bays: the two
# ends of a front of mass against jitter, with the proven bounds of each. `studies/certified-front.yaml` does it for
# twenty bays.

# %%
import tempfile
from pathlib import Path

import fosopt
from fosopt.units import URAD

ROOT = Path(__file__).resolve().parents[1] if "__file__" in globals() else Path("..")
SMALL = [
    "structure.bays=6",
    "constraints.0.lower=52 Hz",
    "variables.0.group_by=kind",
    "front.points=2",
    "certificates.pid.time_limit=0.5 s",
]
study = fosopt.load_study(ROOT / "studies" / "certified-front.yaml", SMALL)
with tempfile.TemporaryDirectory() as folder:
    run = fosopt.run_study(study, Path(folder) / "run")
front = [point for point in run["points"] if point["status"] == "optimal"]
for point in front:
    mass, jitter = point["metrics"]["structural_mass"], point["metrics"]["jitter_total"]
    print(f"{point['label']:24s} {mass:6.3f} kg {jitter / URAD:7.3f} urad  verified {point['verified']}")

# %% [markdown]
# Each bound stands beside what the design has, in kg and rad. The gap is the share of that by which another design
# could be better.

# %%
for point in front:
    print(point["label"])
    for bound in point["bounds"]:
        print(
            f"  {bound['name']:34s} {bound['value']:.5g} of {bound['reached']:.5g}, gap {100 * bound['gap']:.2f} %"
        )

# %% [markdown]
# What is a bound a bound of, and under which assumptions? It says so itself.

# %%
for bound in front[0]["bounds"]:
    print(f"{bound['name']}: {bound['of']}")
    for assumption in bound["assumptions"]:
        print(f"  - {assumption}")

# %% [markdown]
# How to read this front:
#
# - **The lightest design is the lightest.** Nothing in the box meets 52 Hz with less than `mass_lower_bound`, whatever
#   a solver says; the gap is about a hundredth of a percent.
# - **The other is heavier for the sake of jitter**, which `mass_lower_bound` does not know. Held against structures no
#   more compliant than itself it is within a percent of the lightest.
# - **Jitter is open.** The best PID on each structure is somewhere between `jitter_bound_pid` and the design. Half a
#   second of search per point leaves it there; a longer one raises the bound.
