/* What the compiled tick of the learners works on: its sizes, a scenario's tables, the rows of a process. */
#ifndef MEANFLOCK_TABLES_H
#define MEANFLOCK_TABLES_H

#include <stddef.h>
#include <stdint.h>

enum {
    SIZE = 4, AXES = 2, POWERS = 7, FLAT = SIZE * POWERS,
    PER_AXIS = 27, VALUES = AXES * PER_AXIS, BLOCKS = 4 * VALUES, /* σ_H and its three derivatives */
    PAIRS = 15, ALL_PAIRS = 8 * PAIRS, DENSITIES = 69, TERMS = DENSITIES + 1,
    PRODUCTS_MOST = 512, NODES = 64, NUMBERS = 5
};

typedef struct {
    double scale[SIZE], value_factor[BLOCKS], pair_factor[ALL_PAIRS], factorial[TERMS];
    double monomials[TERMS * NODES], kernel[NODES];
    double c1, c2, c3, epsilon, mu_h, push, kappa, drag, wind[AXES], half_variance, gain, arrived_squared, mu_f;
    int32_t value_first[BLOCKS], value_second[BLOCKS], pair_first[ALL_PAIRS], pair_second[ALL_PAIRS];
    int32_t at_position[TERMS], at_velocity[TERMS], left[2 * DENSITIES], right[2 * DENSITIES];
    int32_t weight[PRODUCTS_MOST], term[PRODUCTS_MOST], starts[TERMS + 1];
    int learns_density;
} Tables;

/* Doubles, row after row, wherever they begin. */
typedef struct {
    const char *states, *value, *density; /* SIZE, 2 * VALUES, 2 * DENSITIES a row */
    char *value_out, *density_out, *numbers; /* NUMBERS a row: [a_x, a_y, e_H, e_F, φ_G] */
} Rows;

/* agent.interaction.empirical, with β = 1, of one row: φ_G over the n states it knows; room for n products. */
double empirical(const Tables *t, const double *s, const double *known, ptrdiff_t n, double *products);

/* agent.learner.Learner.step of row `from`; where no density is learned, φ_G is among its numbers already. */
void step_one(const Tables *t, const Rows *rows, ptrdiff_t from, int count);

/* The same of `count` rows beginning with `from`, at most MANY, where the processor has AVX2. */
void step_many(const Tables *t, const Rows *rows, ptrdiff_t from, int count);

#if defined(__x86_64__) && defined(__GNUC__)
#define MANY 4
#else
#define MANY 1 /* there is no step_many */
#endif

#endif
