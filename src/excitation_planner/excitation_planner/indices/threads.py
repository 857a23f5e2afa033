"""One BLAS thread: on matrices of this size more of them only wait for each other."""

import numpy as np  # noqa: F401  (the libraries whose threads are limited must be loaded first)
import scipy.linalg  # noqa: F401
from threadpoolctl import ThreadpoolController

THREADPOOLS = ThreadpoolController()
