"""JUDGE and IDENTIFY: trajectory error of bags, parameter estimates.

`judge.judge(bag)` gives the trajectory error of a recorded drive.

`identification.identify(drives, vehicle)` estimates the unknown parameters. A drive comes from a
bag, `measured_drive.read_measured_drive(bag, vehicle)`, or from a simulation,
`measured_drive.measure(Motion.of(trajectory), commands, noise, rng=rng)`.
"""

from tricycle_core.renamed import install

install()
