"""Planning: from a vehicle, maneuver families and a target to plans; modules load on first use."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
