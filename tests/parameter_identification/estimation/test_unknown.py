"""Parameters that are asked for."""

import pytest
from simulated_drives import VEHICLE

from parameter_identification.estimation.unknown import restrict
from tricycle_core.errors import IdentificationError


def test_a_vehicle_is_restricted_to_parameters_it_has():
    vehicle = restrict(VEHICLE, ("yaw_inertia", "cornering_stiffness"))
    assert tuple(vehicle.unknown) == ("cornering_stiffness", "yaw_inertia")
    with pytest.raises(IdentificationError, match="'mass' is not an unknown parameter"):
        restrict(VEHICLE, ("mass",))
    with pytest.raises(IdentificationError, match=r"a list .* as \['yaw_inertia'\]"):
        restrict(VEHICLE, "yaw_inertia")
    with pytest.raises(IdentificationError, match="nothing to identify"):
        restrict(VEHICLE, ())
