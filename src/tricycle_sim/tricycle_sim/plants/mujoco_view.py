"""Pictures of the plant in MuJoCo by a camera, without a screen."""

import itertools
import math
import os
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tricycle_core.closing import Closing
from tricycle_core.errors import PlantError
from tricycle_core.optional import check_installed
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle

ELEVATION, AZIMUTH = -35.0, 60.0  # degrees, of the camera's axis
DISTANCE = 3.0  # wheelbases from camera to vehicle
LINE = 0.02  # m, width of a line on the ground
SAMPLES = 100  # of a line

RgbFrame = NDArray[np.uint8]


class MujocoView(Closing):
    """A plant in MuJoCo, and a camera that follows it.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle of which the plant is made.
    size : (int, int)
        Width and height of a picture [pixel].

    Attributes
    ----------
    plant : MujocoPlant
        Plant that is shown.

    Raises
    ------
    PlantError
        If this machine cannot render, or MuJoCo is missing.
    """

    def __init__(self, vehicle: Vehicle, size: tuple[int, int]) -> None:
        check_installed("mujoco", "a rendered film")
        if sys.platform == "linux":  # elsewhere MuJoCo's own choice needs no screen
            os.environ.setdefault("MUJOCO_GL", "egl")
        width, height = size
        try:
            import mujoco

            from tricycle_sim.plants.mujoco_plant import MujocoPlant

            self.plant = MujocoPlant(vehicle)
            self._mujoco = mujoco
            self._model, self._data = self.plant.scene
            self._renderer: Any = mujoco.Renderer(self._model, height, width)
        except PlantError:
            raise
        except Exception as error:  # of OpenGL, its loaders and drivers: many kinds
            raise PlantError(
                f"nothing renders here with MUJOCO_GL={os.environ.get('MUJOCO_GL', '')} "
                f"({' '.join(str(error).split()) or type(error).__name__}): set it to egl, osmesa "
                "or glfw, whichever this machine has"
            ) from error
        self._camera: Any = mujoco.MjvCamera()
        self._camera.elevation, self._camera.azimuth = ELEVATION, AZIMUTH
        self._camera.distance = DISTANCE * vehicle.wheelbase
        self._lines: list[tuple[FloatArray, FloatArray]] = []

    def add_line(self, points: FloatArray, rgb: tuple[float, float, float]) -> None:
        """Draw a line on the ground in all further pictures.

        Parameters
        ----------
        points : ndarray of float, shape (n, 2)
            x, y in the world [m].
        rgb : (float, float, float)
            Red, green and blue, 0 to 1.
        """
        rows = np.linspace(0, len(points) - 1, SAMPLES).round().astype(int)
        ground = np.column_stack([points[rows], np.full(SAMPLES, LINE)])
        self._lines.append((ground, np.array([*rgb, 1.0])))

    def picture(self) -> RgbFrame:
        """Return what the camera sees now, shape (height, width, 3)."""
        x, y = self._data.qpos[:2]
        self._camera.lookat[:] = x, y, 0.0
        self._renderer.update_scene(self._data, self._camera)
        for points, colour in self._lines:
            for a, b in itertools.pairwise(points):
                if math.dist(a, b) > 0.0:
                    self._connect(a, b, colour)
        picture: RgbFrame = self._renderer.render()
        return picture

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()

    def _connect(self, a: FloatArray, b: FloatArray, colour: FloatArray) -> None:
        scene, mujoco = self._renderer.scene, self._mujoco
        if scene.ngeom >= scene.maxgeom:
            return
        geom, capsule = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_CAPSULE
        mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.zeros(9), colour)
        mujoco.mjv_connector(geom, capsule, LINE, a, b)
        scene.ngeom += 1
