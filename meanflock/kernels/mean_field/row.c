/* The step of one row at a time, on any processor; and the sum over all UAVs. */
#define LANES 1
#define STEP step_one
#include "rows.h"

double empirical(const Tables *t, const char *state, const char *known, ptrdiff_t n, double *products) {
    double s[VARIABLES], other[VARIABLES];
    memcpy(s, state, sizeof s); /* may be unaligned */
    for (ptrdiff_t j = 0; j < n; j++, known += sizeof other) {
        memcpy(other, known, sizeof other);
        for (int k = 0; k < VARIABLES; k++) other[k] -= s[k];
        const double *velocity = other + DIMENSIONS;
        products[j] = vector(velocity, velocity) / (t->epsilon + vector(other, other));
    }
    return (0.0 + sum_of(products, n)) / (double)n;
}
