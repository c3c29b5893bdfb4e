/* Compiled form of separation.py: the same operations in the same order. */
#define LANES 1
#include "learn.h"

#include <math.h>
#include <string.h>

#include "../axes.h"
#include "../pairwise.h"

static const double FARTHEST = 36.0, LOG2_E = 1.4426950408889634;
static const double LN2_HIGH = 0.693147180369123816490, LN2_LOW = 1.90821492927058770002e-10;
static const double SERIES[] = {
    1.0 / 6227020800.0, 1.0 / 479001600.0, 1.0 / 39916800.0, 1.0 / 3628800.0, 1.0 / 362880.0, 1.0 / 40320.0,
    1.0 / 5040.0, 1.0 / 720.0, 1.0 / 120.0, 1.0 / 24.0, 1.0 / 6.0, 0.5, 1.0, 1.0,
};

/* exp(−u) of 0 ≤ u ≤ FARTHEST */
static double decay(double u) {
    const double k = floor(u * LOG2_E + 0.5), r = k * LN2_LOW - (u - k * LN2_HIGH);
    double series = SERIES[0];
    for (size_t n = 1; n < sizeof SERIES / sizeof *SERIES; n++) series = series * r + SERIES[n];
    return ldexp(series, -(int)k);
}

FOR_AXES void repelled(const int axes, const char *state, const char *known, ptrdiff_t n, double weight, double range,
                       double *room, double *pushed) {
    double s[MOST_AXES], other[MOST_AXES], apart[MOST_AXES];
    const double narrow = 0.5 / (range * range);
    memcpy(s, state, axes * sizeof *s); /* may be unaligned */
    for (ptrdiff_t j = 0; j < n; j++, known += 2 * axes * sizeof *other) {
        memcpy(other, known, axes * sizeof *other);
        for (int k = 0; k < axes; k++) apart[k] = s[k] - other[k];
        const double u = inner(axes, apart, apart) * narrow, falls = u <= FARTHEST ? decay(u) : 0.0;
        for (int k = 0; k < axes; k++) room[k * n + j] = (falls > 0.0 ? apart[k] : 0.0) * falls;
    }
    for (int k = 0; k < axes; k++) pushed[k] = weight * (n ? 0.0 + sum_of(room + k * n, n) : 0.0);
}

void repel(int axes, const char *state, const char *known, ptrdiff_t n, double weight, double range, double *room,
           double *pushed) {
    BY_AXES(axes, repelled, state, known, n, weight, range, room, pushed);
}
