/* The step of one row at a time, on any processor; and the sum over all UAVs. */
#define LANES 1
#define STEP step_one
#include "rows.h"

double empirical(const Tables *t, const char *state, const char *known, ptrdiff_t n, double *products) {
    double s[SIZE], other[SIZE];
    memcpy(s, state, sizeof s); /* may be unaligned */
    for (ptrdiff_t j = 0; j < n; j++, known += sizeof other) {
        memcpy(other, known, sizeof other);
        double x = other[0] - s[0], y = other[1] - s[1], vx = other[2] - s[2], vy = other[3] - s[3];
        products[j] = (0.0 + (vx * vx + vy * vy)) / (t->epsilon + (0.0 + (x * x + y * y)));
    }
    return (0.0 + sum_of(products, n)) / (double)n;
}
