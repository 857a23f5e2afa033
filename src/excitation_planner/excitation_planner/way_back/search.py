"""The search for a route beside the 100 Hz ticks: it may take seconds, a tick may not."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor

from excitation_planner.way_back.dubins import Arc
from excitation_planner.way_back.route import RouteRequest, find_route
from tricycle_core.closing import Closing


class RouteSearch(Closing):
    """Looks for the route that is wanted, in a thread, and gives up one that no longer is."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, "routes")
        self._wanted: RouteRequest | None = None
        self._route: Future[tuple[Arc, ...]] | None = None
        self._abandoned = threading.Event()

    def route(self, wanted: RouteRequest | None) -> tuple[Arc, ...] | None:
        """Return the arcs of the route that is wanted; None while it is looked for.

        Parameters
        ----------
        wanted : RouteRequest or None
            Request, of which the start tells one from another; None: no route is wanted.

        Raises
        ------
        PlanError
            If there is none.
        """
        if wanted is None or self._wanted is None or wanted.start != self._wanted.start:
            self._abandoned.set()
            self._wanted, self._route = wanted, None
            if wanted is not None:
                self._abandoned = threading.Event()
                self._route = self._thread.submit(find_route, wanted, self._abandoned.is_set)
        elif self._route is not None and self._route.done():
            return self._route.result()
        return None

    def close(self) -> None:
        """Give up what is looked for; Python waits for the thread when it ends."""
        self._abandoned.set()
        self._thread.shutdown(wait=False, cancel_futures=True)
