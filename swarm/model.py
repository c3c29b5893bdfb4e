"""Where a number of a controller, of its model or of its diagnostics stops to be one."""

BEYOND_SENSE = 1e30  # none is as large; NaN is not below it
