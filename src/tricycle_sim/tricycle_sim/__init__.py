"""The 9-DOF tricycle, its emulated PLCs and the simulation node."""

from tricycle_core.renamed import install

install()
