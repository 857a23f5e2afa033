"""Boards and vehicle on one clock: emulated boards, or the firmware on simulated UNOs."""
