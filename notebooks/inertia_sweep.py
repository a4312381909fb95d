# %% [markdown]
# # A sweep of inertia ratios
#
# How heavy may the mirror be? The dissertation's system over mirror inertias from 0.002 % to 20 % of the truss, with
# the gains of a controller designed on a rigid support: poles, zeros, jitter, and where stability is lost.
#
# `fosopt run studies/inertia-sweep.yaml` does the same with 401 points and draws it.

# %%
import csv
import tempfile
from pathlib import Path

import numpy as np

import fosopt
from fosopt.units import HZ, URAD

ROOT = Path(__file__).resolve().parents[1] if "__file__" in globals() else Path("..")
study = fosopt.load_study(ROOT / "studies" / "inertia-sweep.yaml", ["sweep.axes.0.log.points=101"])
with tempfile.TemporaryDirectory() as folder:
    fosopt.run_study(study, folder)
    found = {path.stem: np.load(path) for path in (Path(folder) / "arrays").glob("*.npy")}
    with (Path(folder) / "boundary.csv").open(encoding="utf-8") as file:
        boundary = list(csv.DictReader(file))
print({name: values.shape for name, values in sorted(found.items())})

# %% [markdown]
# One row per inertia ratio, one column per mode. Jitter has no value where the loop is unstable.

# %%
ratio, jitter = found["mirror_inertia_ratio"], found["jitter_total"]
for k in range(0, ratio.size, 20):
    print(
        f"{100 * ratio[k]:8.4f} %  stable {bool(found['stable'][k])!s:5s}  jitter {jitter[k] / URAD:8.2f} urad"
    )

# %% [markdown]
# The boundary is solved for, not read off a grid.

# %%
for row in boundary:
    print(
        f"{row['rising']} at {100 * float(row['mirror_inertia_ratio']):.4f} %, {float(row['frequency_hz']):.2f} Hz, "
        f"structural mode {row['structural_mode']}"
    )

# %% [markdown]
# Why there? As the mirror grows, the pole of that mode parts from its zero, the mode of the truss alone, and the loop
# has a longer way to bring it back. What parts them is the share of the mode in the mirror's motion.

# %%
mode = int(boundary[0]["structural_mode"]) - 1
print("inertia ratio   frequency [Hz]   1 - beta   effective modal reaction inertia")
for k in range(0, ratio.size, 20):
    print(
        f"{100 * ratio[k]:11.4f} %   {found['natural_frequency'][k, mode] / HZ:14.4f}   "
        f"{found['one_minus_separation'][k, mode]:8.1e}   {found['effective_modal_reaction_inertia'][k, mode]:.1e}"
    )
total = np.nansum(found["effective_modal_reaction_inertia"], axis=1)
print("they sum to one at every inertia, to 1e-12:", bool(np.abs(total - 1).max() < 1e-12))
