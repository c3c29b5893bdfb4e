/* One row at a time, on any machine; and the one sum that is as long as the swarm. */
#define LANES 1
#define STEP step_one
#include "rows.h"

TARGET double empirical(const Tables *t, const double *s, const double *known, ptrdiff_t n,
                        double *__restrict products) {
    for (ptrdiff_t j = 0; j < n; j++, known += SIZE) {
        double x = known[0] - s[0], y = known[1] - s[1], vx = known[2] - s[2], vy = known[3] - s[3];
        products[j] = (0.0 + (vx * vx + vy * vy)) / (t->epsilon + (0.0 + (x * x + y * y)));
    }
    return (0.0 + sum_of(products, n)) / (double)n;
}
