/* What worldsim/summary.py says in NumPy of how far models are apart: the same operations in the same order. */
#define LANES 1
#include <math.h>

#include "../swarm/pairwise.h"
#include "tick.h"

double spread(const double *models, ptrdiff_t n, ptrdiff_t width, double bound, double *room) {
    double *mean = room, *squared = mean + width, *apart = squared + width;
    int sane = 1;
    for (ptrdiff_t k = 0; k < width; k++) mean[k] = models[k];
    for (ptrdiff_t i = 1; i < n; i++)
        for (ptrdiff_t k = 0; k < width; k++) mean[k] += models[i * width + k];
    for (ptrdiff_t k = 0; k < width; k++) mean[k] /= (double)n;
    for (ptrdiff_t i = 0; i < n; i++) {
        for (ptrdiff_t k = 0; k < width; k++) {
            double weight = models[i * width + k], deviation = weight - mean[k];
            sane &= fabs(weight) < bound; /* NaN is below nothing */
            squared[k] = deviation * deviation;
        }
        apart[i] = sum_of(squared, width);
    }
    if (!sane) return -1.0;
    return sqrt(sum_of(apart, n) / (double)n);
}
