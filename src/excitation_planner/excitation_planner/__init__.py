"""PLAN: excitation maneuvers by Kriging, Sobol' indices and DIRECT."""
