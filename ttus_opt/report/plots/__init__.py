"""Plots, one per file: each function returns a figure, `save_picture` writes it."""

from ttus_opt.report.plots.canvas import (
    require_picture_suffix as require_picture_suffix,
)
from ttus_opt.report.plots.canvas import save_picture as save_picture
from ttus_opt.report.plots.forces import force_over_time as force_over_time
from ttus_opt.report.plots.forces import residual_histogram as residual_histogram
from ttus_opt.report.plots.overview import overview as overview
from ttus_opt.report.plots.poses import pose_picture as pose_picture
from ttus_opt.report.plots.potential import field_slice as field_slice
from ttus_opt.report.plots.potential import potential_slices as potential_slices
from ttus_opt.report.plots.surface import surface_picture as surface_picture
from ttus_opt.report.plots.uncertainty import (
    calibration_picture as calibration_picture,
)
from ttus_opt.report.plots.uncertainty import next_press_picture as next_press_picture
from ttus_opt.report.plots.uncertainty import uncertainty_picture as uncertainty_picture
from ttus_opt.report.plots.weights import weight_path as weight_path
