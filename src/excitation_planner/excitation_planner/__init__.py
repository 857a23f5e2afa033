"""PLAN: excitation maneuvers by Kriging, Sobol' indices and DIRECT; the planner and the maneuver driver."""
