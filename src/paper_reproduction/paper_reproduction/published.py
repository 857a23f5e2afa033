"""Numbers printed in the paper (ASME IDETC2020-22257)."""

ITEMS = (
    "table1",
    *("fig5", "fig6", "fig8", "fig9"),
    "screening",
    *("fig13", "fig14", "fig15", "fig16", "fig17", "fig18"),
)
"""Tables and figures that are computed again."""

# Table 1: exact indices of the math model (Eq. 13), p1 to p4, and S of p1 by Monte Carlo
TABLE_1_X = (-2.0, -0.5, -2.0, -0.5)
TABLE_1_MAIN = (0.0033, 0.0033, 0.2063, 0.2063)
TABLE_1_TOTAL = (0.5798, 0.5798, 0.2220, 0.2220)
TABLE_1_MONTE_CARLO = {10**3: 0.2448, 10**4: 0.0787, 10**5: 0.0208}  # base samples N -> S of p1

# Fig. 5: Kriging of the math model
FIG_5_X = (-0.5, -2.0, -0.5, -2.0)
FIG_5_TRAINING, FIG_5_VALIDATION = 1000, 10_000
FIG_5_R2, FIG_5_RAAE = 0.99997, 0.0019

# Fig. 6: the estimator converges to this error of S from this many base samples on
FIG_6_ERROR, FIG_6_SAMPLES = (0.0005, 0.002), 500_000

# Figs. 8 and 9: points of the second stage
SECOND_STAGE_POINTS = 96

# Fig. 13: Kriging of the double lane change's trajectory error
FIG_13_X = (2.0, 2.0)  # m, handle lengths
FIG_13_R2, FIG_13_RAAE, FIG_13_MEAN = 0.9145, 0.1030, 9.0876

# Algorithm 1 on the tricycle
INITIAL_SAMPLES, INFILL_SAMPLES = 4000, 200
