/* Compiled form of features.py, interaction.py, hjb.py and fpk.py, for LANES rows at once, a row a lane. row.c, rows.c
 * and wide_rows.c include it.
 *
 * A lane performs the operations of its row in the same order and never reads another lane, so the bits are the same.
 * Tables are common to all rows, so an index selects whole vectors.
 */
#include <float.h>
#include <math.h>
#include <string.h>
#if LANES > 1
#include <immintrin.h>
#endif

#include "../pairwise.h"
#include "learn.h"

#if LANES > 1
typedef int64_t Mask __attribute__((vector_size(LANES * sizeof(double)))); /* all bits of a lane, or none */
INLINE Lanes chosen(Mask which, Lanes yes, Lanes no) { return (Lanes)(((Mask)yes & which) | ((Mask)no & ~which)); }
#else
typedef int64_t Mask;
INLINE Lanes chosen(Mask which, Lanes yes, Lanes no) { return which ? yes : no; }
#endif

enum { NODES_AT_ONCE = LANES > 1 ? 8 : NODES }; /* sums that stay in registers */

INLINE int any(Mask which) {
    int64_t lane[LANES], found = 0;
    memcpy(lane, &which, sizeof lane);
    for (int w = 0; w < LANES; w++) found |= lane[w];
    return found != 0;
}

INLINE Lanes root(Lanes x) {
    double lane[LANES];
    memcpy(lane, &x, sizeof lane);
    for (int w = 0; w < LANES; w++) lane[w] = sqrt(lane[w]);
    memcpy(&x, lane, sizeof lane);
    return x;
}

/* np.maximum: NaN stays NaN. */
INLINE Lanes at_least(Lanes x, double least) { return chosen(x < least, (Lanes){0} + least, x); }

/* NumPy's pairwise sum of more numbers: in two halves, the first of them a multiple of eight; n: 1 … 2 * PAIRWISE. */
INLINE Lanes in_halves(const Lanes *a, const Lanes *b, int n) {
    int half = n > PAIRWISE ? n / 2 - n / 2 % 8 : 0;
    Lanes sum = pairwise(a + half, b == NULL ? NULL : b + half, n - half);
    return half ? pairwise(a, b, half) + sum : sum;
}

/* swarm.state.dot: np.sum of the products, which begins at zero; n: 1 … 4 * PAIRWISE. */
INLINE Lanes dot(const Lanes *a, const Lanes *b, int n) {
    int half = n > 2 * PAIRWISE ? n / 2 - n / 2 % 8 : 0;
    Lanes sum = in_halves(a + half, b + half, n - half);
    return 0.0 + (half ? in_halves(a, b, half) + sum : sum);
}

#if DIMENSIONS == 2
#define sum_of_terms pairwise /* a term has no more products */
#else
#define sum_of_terms in_halves
#endif

INLINE Lanes vector(const Lanes *a, const Lanes *b) { return dot(a, b, DIMENSIONS); }

/* interaction.py: quadrature; terms: [1, σ_F] */
INLINE Lanes quadrature(const Tables *t, const Lanes *weights, const Lanes *terms) {
    Lanes w[DENSITIES], s[TERMS], coefficient[TERMS], mass[NODES], weighed[NODES];
    for (int k = 0; k < DENSITIES; k++) w[k] = weights[k] * t->factorial[k + 1];
    for (int k = 0; k < TERMS; k++) s[k] = terms[k] / t->factorial[k];
    for (int k = 0; k < TERMS; k++) {
        Lanes products[TERMS];
        int p = t->starts[k], n = t->starts[k + 1] - p;
        for (int i = 0; i < n; i++) products[i] = w[t->weight[p + i]] * s[t->term[p + i]];
        coefficient[k] = n > 1 ? products[0] + sum_of_terms(products + 1, NULL, n - 1) : products[0];
    }
    for (int q = 0; q < NODES; q += NODES_AT_ONCE) {
        Lanes sum[NODES_AT_ONCE];
        for (int i = 0; i < NODES_AT_ONCE; i++) sum[i] = (Lanes){0};
        const double *monomials = t->monomials + q;
        for (int k = 0; k < TERMS; k++, monomials += NODES)
            for (int i = 0; i < NODES_AT_ONCE; i++) sum[i] += coefficient[k] * monomials[i];
        for (int i = 0; i < NODES_AT_ONCE; i++) mass[q + i] = at_least(sum[i], 0.0);
    }
    for (int q = 0; q < NODES; q++) weighed[q] = mass[q] * t->kernel[q];
    return (0.0 + pairwise(weighed, NULL, NODES)) / at_least(0.0 + pairwise(mass, NULL, NODES), DBL_MIN);
}

/* hjb.py: step; numbers: [a_x, a_y, e_H, …]. Returns the curvature. */
INLINE Lanes value_step(const Tables *t, const Lanes *s, const Lanes *powers, Lanes phi_g, const Lanes *weights,
                        Lanes *stepped, Lanes *numbers) {
    Lanes blocks[BLOCKS], gradient[2 * VALUES], before[DIMENSIONS], drift[DIMENSIONS];
    Lanes slope[DIMENSIONS], by_position[DIMENSIONS];
    const Lanes *v = s + DIMENSIONS; /* the velocity */
    for (int k = 0; k < BLOCKS; k++)
        blocks[k] = powers[t->value_first[k]] * powers[t->value_second[k]] * t->value_factor[k];
    const Lanes *sigma = blocks, *by_r = blocks + VALUES, *by_v = blocks + 2 * VALUES, *bend = blocks + 3 * VALUES;

    for (int x = 0; x < DIMENSIONS; x++) {
        before[x] = -t->gain * dot(by_v + x * PER_AXIS, weights + x * PER_AXIS, PER_AXIS);
        drift[x] = before[x] - t->drag * (v[x] - t->wind[x]);
    }
    for (int x = 0; x < DIMENSIONS; x++)
        for (int k = x * PER_AXIS; k < (x + 1) * PER_AXIS; k++)
            gradient[k] = bend[k] * t->half_variance + v[x] * by_r[k] + drift[x] * by_v[k];
    memcpy(gradient + VALUES, sigma, VALUES * sizeof *sigma);

    Lanes residual = dot(weights, gradient, 2 * VALUES);
    residual += t->c3 * vector(before, before);
    residual += vector(v, s) / at_least(root(vector(s, s)), DBL_MIN) + t->c1 * vector(v, v);
    residual += t->c2 * phi_g;

    Lanes rate = t->mu_h * residual;
    for (int k = 0; k < 2 * VALUES; k++) stepped[k] = weights[k] - rate * gradient[k];
    for (int x = 0; x < DIMENSIONS; x++) {
        by_position[x] = s[x] + t->kappa * v[x];
        slope[x] = t->kappa * s[x] + v[x];
    }
    Mask leaving = vector(by_position, v) + vector(slope, drift) > 0.0;
    Mask pushed = leaving & (dot(s, s, VARIABLES) >= t->arrived_squared);
    if (any(pushed))
        for (int x = 0; x < DIMENSIONS; x++)
            for (int k = x * PER_AXIS; k < (x + 1) * PER_AXIS; k++)
                stepped[k] = chosen(pushed, stepped[k] + t->push * slope[x] * by_v[k], stepped[k]);
    for (int x = 0; x < DIMENSIONS; x++)
        numbers[x] = -t->gain * dot(by_v + x * PER_AXIS, stepped + x * PER_AXIS, PER_AXIS);
    numbers[DIMENSIONS] = residual;
    return dot(bend, stepped, VALUES);
}

/* fpk.py: step; returns e_F. */
INLINE Lanes density_step(const Tables *t, const Lanes *s, const Lanes *pairs, const Lanes *terms, const Lanes *action,
                          Lanes curvature, const Lanes *weights, Lanes *stepped) {
    Lanes parts[4 * PAIRS], gradient[2 * DENSITIES], drift[DIMENSIONS];
    Lanes divergence = -(double)DIMENSIONS * t->drag - t->gain * curvature;
    double spread = -t->half_variance;
    const Lanes *v = s + DIMENSIONS, *velocity = pairs + (1 + DIMENSIONS) * PAIRS;
    for (int x = 0; x < DIMENSIONS; x++) drift[x] = action[x] - t->drag * (v[x] - t->wind[x]);
    for (int k = 0; k < PAIRS; k++) {
        Lanes carried = divergence * pairs[k], driven = drift[0] * velocity[PAIRS + k];
        for (int x = 0; x < DIMENSIONS; x++) carried += v[x] * pairs[(1 + x) * PAIRS + k];
        for (int x = 1; x < DIMENSIONS; x++) driven += drift[x] * velocity[(1 + x) * PAIRS + k];
        for (int x = 0; x < DIMENSIONS; x++) driven += spread * velocity[(1 + DIMENSIONS + x) * PAIRS + k];
        parts[k] = pairs[k], parts[PAIRS + k] = carried;
        parts[2 * PAIRS + k] = velocity[k], parts[3 * PAIRS + k] = driven;
    }
    for (int k = 0; k < DENSITIES; k++)
        gradient[k] = (parts[t->left[k]] * parts[t->right[k]]
                     + parts[t->left[DENSITIES + k]] * parts[t->right[DENSITIES + k]]) * t->coefficient[k + 1];
    memcpy(gradient + DENSITIES, terms + 1, DENSITIES * sizeof *terms);
    Lanes residual = dot(weights, gradient, 2 * DENSITIES), rate = t->mu_f * residual;
    for (int k = 0; k < 2 * DENSITIES; k++) stepped[k] = weights[k] - rate * gradient[k];
    return residual;
}

#if LANES > 1
/* Copies four numbers of each of four rows into vectors of one number each, or such vectors into rows. */
INLINE void transpose(double *to, ptrdiff_t to_step, const double *from, ptrdiff_t from_step) {
    const __m256d a = _mm256_loadu_pd(from), b = _mm256_loadu_pd(from + from_step);
    const __m256d c = _mm256_loadu_pd(from + 2 * from_step), d = _mm256_loadu_pd(from + 3 * from_step);
    const __m256d ab_low = _mm256_unpacklo_pd(a, b), ab_high = _mm256_unpackhi_pd(a, b);
    const __m256d cd_low = _mm256_unpacklo_pd(c, d), cd_high = _mm256_unpackhi_pd(c, d);
    _mm256_storeu_pd(to, _mm256_permute2f128_pd(ab_low, cd_low, 0x20));
    _mm256_storeu_pd(to + to_step, _mm256_permute2f128_pd(ab_high, cd_high, 0x20));
    _mm256_storeu_pd(to + 2 * to_step, _mm256_permute2f128_pd(ab_low, cd_low, 0x31));
    _mm256_storeu_pd(to + 3 * to_step, _mm256_permute2f128_pd(ab_high, cd_high, 0x31));
}
#endif

/* Copies rows into lanes: n doubles of each, one row every `stride` doubles. Lanes without a row repeat the first row. */
INLINE void take(Lanes *lanes, const char *rows, ptrdiff_t from, int count, int n, int stride) {
    double *to = (double *)lanes;
    int done = 0;
#if LANES > 1
    if (count == LANES)
        for (; done <= n - 4; done += 4)
            for (int w = 0; w < LANES; w += 4)
                transpose(to + done * LANES + w, LANES, (const double *)rows + (from + w) * stride + done, stride);
#endif
    for (int w = 0; w < LANES; w++) {
        const char *row = rows + (from + (w < count ? w : 0)) * stride * sizeof(double);
        for (int k = done; k < n; k++) memcpy(to + k * LANES + w, row + k * sizeof(double), sizeof(double));
    }
}

/* Copies lanes into rows. */
INLINE void give(const Lanes *lanes, char *rows, ptrdiff_t from, int count, int n, int stride) {
    const double *of = (const double *)lanes;
    int done = 0;
#if LANES > 1
    if (count == LANES)
        for (; done <= n - 4; done += 4)
            for (int w = 0; w < LANES; w += 4)
                transpose((double *)rows + (from + w) * stride + done, stride, of + done * LANES + w, LANES);
#endif
    for (int w = 0; w < count; w++) {
        char *row = rows + (from + w) * stride * sizeof(double);
        for (int k = done; k < n; k++) memcpy(row + k * sizeof(double), of + k * LANES + w, sizeof(double));
    }
}

TARGET void STEP(const Tables *t, const Rows *rows, ptrdiff_t from, int count) {
    Lanes s[VARIABLES], weights[WEIGHTS], stepped[WEIGHTS], numbers[NUMBERS];
    Lanes powers[ALL_POWERS], pairs[ALL_PAIRS], terms[TERMS];
    Lanes *density = weights + 2 * VALUES, *density_stepped = stepped + 2 * VALUES;
    take(s, rows->states, from, count, VARIABLES, VARIABLES);
    take(weights, rows->weights, from, count, WEIGHTS, WEIGHTS);
    for (int c = 0; c < VARIABLES; c++) {
        Lanes u = s[c] / t->scale[c], power = 1.0 + (Lanes){0};
        for (int k = 0; k < POWERS; k++, power *= u) powers[c * POWERS + k] = power;
    }
    if (!rows->learns_density) {
        take(numbers, rows->numbers, from, count, NUMBERS, NUMBERS);
        value_step(t, s, powers, numbers[DIMENSIONS + 2], weights, stepped, numbers);
        numbers[DIMENSIONS + 1] = (Lanes){0};
        memcpy(density_stepped, density, 2 * DENSITIES * sizeof *density);
    } else {
        for (int k = 0; k < ALL_PAIRS; k++) {
            pairs[k] = powers[t->pair_first[k]] * powers[t->pair_second[k]];
#if DIMENSIONS > 2
            pairs[k] *= powers[t->pair_third[k]];
#endif
            pairs[k] *= t->pair_factor[k];
        }
        for (int k = 0; k < TERMS; k++)
            terms[k] = pairs[t->at_position[k]] * pairs[(1 + DIMENSIONS) * PAIRS + t->at_velocity[k]] * t->coefficient[k];
        numbers[DIMENSIONS + 2] = quadrature(t, density, terms);
        Lanes curvature = value_step(t, s, powers, numbers[DIMENSIONS + 2], weights, stepped, numbers);
        numbers[DIMENSIONS + 1] = density_step(t, s, pairs, terms, numbers, curvature, density, density_stepped);
    }
    give(stepped, rows->weights_out, from, count, WEIGHTS, WEIGHTS);
    give(numbers, rows->numbers, from, count, NUMBERS, NUMBERS);
}
