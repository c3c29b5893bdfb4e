/* Functions for any number of axes.
 *
 * Such a function takes the number as its first parameter, is always inlined, and is called with a constant, so that the
 * compiler makes code for that number alone. Sums over the axes start from the first product, which is the order of
 * kernels/state.py.
 */
#ifndef MEANFLOCK_AXES_H
#define MEANFLOCK_AXES_H

enum { PLANE = 2, SPACE = 3, MOST_AXES = SPACE }; /* axes of a flight; the most that local arrays have room for */

/* Calls f(axes, ...) with a constant number of axes. */
#define BY_AXES(axes, f, ...) ((axes) == PLANE ? f(PLANE, __VA_ARGS__) : f(SPACE, __VA_ARGS__))

#if defined(__GNUC__)
#define FOR_AXES static inline __attribute__((always_inline))
#else
#define FOR_AXES static inline
#endif

/* Inner product. */
FOR_AXES double inner(const int axes, const double *a, const double *b) {
    double sum = a[0] * b[0];
    for (int k = 1; k < axes; k++) sum += a[k] * b[k];
    return sum;
}

#endif
