/* One row at a time, on any machine; and the one sum that is as long as the swarm. */
#define LANES 1
#define STEP step_one
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define TARGET __attribute__((target_clones("default", "avx2"))) /* wider vectors, the same operations */
#else
#define TARGET
#endif
#include "rows.h"

static double sum_of(const double *a, ptrdiff_t n) {
    if (n <= PAIRWISE) return pairwise(a, NULL, (int)n);
    ptrdiff_t half = n / 2 - n / 2 % 8;
    return sum_of(a, half) + sum_of(a + half, n - half);
}

TARGET double empirical(const Tables *t, const double *s, const double *known, ptrdiff_t n,
                        double *__restrict products) {
    for (ptrdiff_t j = 0; j < n; j++, known += SIZE) {
        double x = known[0] - s[0], y = known[1] - s[1], vx = known[2] - s[2], vy = known[3] - s[3];
        products[j] = (0.0 + (vx * vx + vy * vy)) / (t->epsilon + (0.0 + (x * x + y * y)));
    }
    return (0.0 + sum_of(products, n)) / (double)n;
}
