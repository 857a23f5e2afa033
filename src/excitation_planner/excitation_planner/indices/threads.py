"""Control of the BLAS threads: one is fastest on matrices of this size."""

import numpy as np  # noqa: F401  (the libraries whose threads are limited must be loaded first)
import scipy.linalg  # noqa: F401
from threadpoolctl import ThreadpoolController

THREADPOOLS = ThreadpoolController()
