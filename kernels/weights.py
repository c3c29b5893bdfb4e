"""The layout of what the mean-field learners have learned: [ŵ_H0 (54), ŵ_H1 (54), ŵ_F0 (69), ŵ_F1 (69)]."""

VALUE_FEATURES = 54  # M_H: terms of σ_H
DENSITY_FEATURES = 69  # M_F: terms of σ_F
VALUE = slice(0, 2 * VALUE_FEATURES)
DENSITY = slice(VALUE.stop, VALUE.stop + 2 * DENSITY_FEATURES)
MODEL_FLOATS = DENSITY.stop  # 246
NUMBERS = 5  # of a step: [a_x, a_y, e_H, e_F, φ_G]
