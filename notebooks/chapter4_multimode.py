# %% [markdown]
# # Chapter 4: sixty-one modes
#
# The mirror on the full truss. Five inertias tell what it can disturb, and the loop tells whether that matters.
# `fosopt reproduce chapter-4` draws every figure of the chapter.

# %%
import numpy as np

from fosopt.metrics.inertias import reference_inertia
from fosopt.reproduce import chapter4_system as system
from fosopt.units import HZ

support = system.support()
J_ref = reference_inertia(support, "tip")
print(f"reference inertia {J_ref:.4f} kg m^2")
for percent in (0.002, 20.0):
    print(f"J_m = {percent} % of the truss is {system.mirror(percent).inertia / J_ref:.2f} times that")

# %% [markdown]
# ## What a small mirror disturbs
#
# The effective modal reaction inertias sum to one. A small mirror has nearly all of it in its own mode, the fifth. Of
# what is beyond the loop's bandwidth, the modes just below 400 Hz have the most.

# %%
coupled = system.coupled(0.002)
share = coupled.effective_modal_reaction_inertia
print(f"sum {share.sum():.15f}, mirror mode {coupled.mirror_mode + 1} with {share[coupled.mirror_mode]:.4f}")
above = np.flatnonzero(coupled.natural_frequency > 300 * HZ)
for k in above[np.argsort(share[above])[::-1][:3]]:
    print(f"mode {k + 1} at {coupled.natural_frequency[k] / HZ:.1f} Hz: {share[k]:.2e}")

# %% [markdown]
# ## A mirror too heavy for its truss
#
# The same controller on ever heavier mirrors: two percent of the truss's inertia is too much, with seven modes as with
# all of them. Poles decide, never a jitter number.

# %%
for percent in (0.02, 0.2, 2.0, 20.0):
    for model in ("reduced", "full"):
        verdict, how = system.stability(percent, model), system.growth(percent, model)
        print(f"{percent:5} % {system.order(model):6s} {verdict:8s} {how}")

# %% [markdown]
# ## Why a truth model
#
# At 0.002 % what is left of a step after the transient stays within 100 udu on the model it was designed on, and does
# not on the full one.

# %%
for model in ("reduced", "full"):
    left = system.residual(0.002, model)
    print(
        f"{system.order(model):6s} largest residual from 100 to 200 ms: {1e6 * left.largest(0.1, 0.2):.0f} udu"
    )
