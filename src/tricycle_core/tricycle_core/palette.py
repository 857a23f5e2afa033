"""Colours of all figures, by Okabe and Ito (2008); colour-blind readers can distinguish them."""

BLUE = "#0072B2"
VERMILLION = "#D55E00"
GREEN = "#009E73"
ORANGE = "#E69F00"
PURPLE = "#CC79A7"
SKY_BLUE = "#56B4E9"
GREY = "#8A8A8A"
