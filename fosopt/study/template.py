"""The study file that ``fosopt new`` writes, the same as ``studies/quickstart.yaml``."""

TEMPLATE = """\
# A co-design study, in seconds: how light can the truss be, and how still the beam?
#
#   fosopt check <this file>    prints the problem as mathematics
#   fosopt run <this file>      solves it
#
# Numbers carry a unit ("66 mm^2") or are SI when bare; a bare frequency is in rad/s.

fosopt: 1                        # version of this format
name: Quickstart
kind: codesign                   # or: analysis, which judges one design and changes nothing

structure:
  type: barker_truss             # the dissertation's planar truss: 20 bays, 7.07 m, 108.3 kg
  boundary: pinned               # table | fixed | pinned: free to rotate about the hub
  bays: 20

hub:
  type: held                     # free | fixed | held by a slow attitude loop
  bandwidth: 0.1 Hz
  damping_ratio: 0.7

damping:
  uniform: 0.2 %                 # of every structural mode; or per_mode: [...], or table: damping.csv

mirror:
  port: tip                      # where it is mounted
  mass_fraction: 0.7             # of the total mass of the start design
  inertia_ratio: 0.2 %           # of the structure's inertia about the hub
  frequency: 20 Hz
  damping_ratio: 0.01

controller:                      # K(s) = gain (kd s^2 + kp s + ki)/s
  type: pid
  kd: 1
  kp: 600
  ki: 50000
  crossover: 100 Hz              # sets the gain, on a rigid support

disturbances:
  - name: aft_body               # its jitter is the metric jitter_aft_body
    at: hub_torque               # mirror_torque | hub_torque | line_of_sight | sensor_noise
    filter: {type: low_pass, corner: 10 Hz, order: 2, rms: 150 N m}
  - name: noise
    at: sensor_noise
    filter: {type: high_pass, corner: 70 Hz, density: 0.2 urad/sqrt(Hz)}   # or psd: noise.csv

variables:
  - quantity: area
    group_by: kind               # member | bay | kind | all: how many areas vary on their own
    lower: 13 mm^2
    upper: 330 mm^2
  - quantity: crossover
    lower: 20 Hz
    upper: 500 Hz
  - quantity: kp
    lower: 10
    upper: 6000
  - quantity: ki
    lower: 100
    upper: 5.0e+6

objectives:                      # one, or two for a Pareto front; names or expressions of metrics
  - minimize: structural_mass
  - minimize: jitter_total

constraints:
  - metric: first_elastic_frequency
    lower: 4 Hz
  - metric: modulus_margin
    lower: 0.5

front:
  points: 5

solve:
  strategy: simultaneous         # simultaneous | nested | sequential
  time_limit: 60 s               # per optimization
"""
