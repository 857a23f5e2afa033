"""What every rig is: vehicle, steer board and drive board on one clock."""

from abc import abstractmethod

from tricycle_bridge.protocol.messages import Board
from tricycle_core.closing import Closing
from tricycle_core.timing import TICK
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.live import LiveState, LiveVehicle


class Rig(Closing):
    """Vehicle, steer board and drive board on one clock that `step` moves on by 10 ms.

    Bytes in, bytes and states out; ports, wall clock and topics belong to the node that owns it.

    Parameters
    ----------
    vehicle : Vehicle
        With its true values.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._ticks = 0
        self._live = LiveVehicle(vehicle)

    @property
    def time(self) -> float:
        """Simulated time in s; it never goes back."""
        return self._ticks * TICK

    @property
    def state(self) -> LiveState:
        """The vehicle's state at `time`."""
        return self._live.state

    @property
    @abstractmethod
    def armed(self) -> bool:
        """Whether both boards are armed."""

    @property
    def answered(self) -> bool:
        """Whether both boards were sent a command since the last step."""
        return all(self.heard(board) for board in (Board.STEER, Board.DRIVE))

    @abstractmethod
    def heard(self, board: Board) -> bool:
        """Return whether a board was sent a command since the last step.

        Parameters
        ----------
        board : Board
            Steer or drive.
        """

    def reset(self) -> None:
        """Put the vehicle at rest at the origin and reboot both boards; time goes on."""
        self._live = LiveVehicle(self._vehicle)
        self._reboot()

    @abstractmethod
    def _reboot(self) -> None:
        """Bring both boards into the state after power-on."""

    @abstractmethod
    def receive(self, board: Board, data: bytes) -> bytes:
        """Hand bytes of the host to a board; return its immediate answers.

        Parameters
        ----------
        board : Board
            Steer or drive.
        data : bytes
            As they come from the line.
        """

    @abstractmethod
    def step(self) -> dict[Board, bytes]:
        """Run one tick: boards measure and control, the vehicle moves. Return what boards sent."""

    def close(self) -> None:
        """Free what the boards hold."""
