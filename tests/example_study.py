"""A study file the tests of its rules break line by line."""

EXAMPLE = """\
# A co-design study: how light can the truss be, and how still the beam?
#
#   fosopt check <this file>    prints the problem as mathematics
#   fosopt run <this file>      solves it
#
# Numbers carry a unit ("66 mm^2") or are SI when bare; a bare frequency is in rad/s.

fosopt: 1                        # version of this format
name: Mass against jitter
kind: codesign                   # or: analysis, which judges one design and changes nothing

structure:
  type: barker_truss             # planar truss with alternating diagonals and rigid battens
  boundary: pinned               # table | fixed | pinned
  bays: 20

hub:
  type: free                     # free | fixed | held by an attitude loop (bandwidth, damping_ratio)

damping:
  uniform: 0.1 %                 # of every structural mode

modes:
  count: 12                      # modes of the design model; leave out to keep all

mirror:
  port: tip                      # where it is mounted
  mass_fraction: 0.7             # of the total mass of the start design
  inertia_ratio: 0.02 %          # mirror inertia over structure inertia about the hub
  frequency: 20 Hz               # of the mirror on its flexure
  damping_ratio: 0.01

controller:                      # K(s) = gain (kd s^2 + kp s + ki)/s
  type: pid
  kd: 1
  kp: 600
  ki: 50000
  crossover: 230 Hz              # sets the gain, on a mirror with rigid support

disturbances:
  - name: cooling                # its jitter is the metric jitter_cooling
    at: mirror_torque            # mirror_torque | hub_torque | line_of_sight | sensor_noise
    filter: {type: low_pass, corner: 8.5 Hz, order: 1, rms: 0.02 N m}
    band: [0.1 Hz, 2 kHz]
  - name: sensor
    at: sensor_noise
    filter: {type: high_pass, corner: 70 Hz, order: 1, density: 0.01 urad/sqrt(Hz)}
    band: [0.1 Hz, 2 kHz]

variables:
  - quantity: area
    group_by: kind               # member | bay | kind | all: how many areas vary on their own
    lower: 20 mm^2
    upper: 500 mm^2
    start: 66 mm^2
  - quantity: crossover
    lower: 100 Hz
    upper: 400 Hz

objectives:                      # one, or two for a Pareto front
  - minimize: structural_mass
  - minimize: jitter_total

constraints:
  - metric: first_elastic_frequency
    lower: 6 Hz
  - metric: modulus_margin
    lower: 0.5

front:
  points: 5

solve:
  strategy: simultaneous         # simultaneous | nested | sequential
  time_limit: 60 s               # per point
"""
