/* Data of the compiled tick of the learners: sizes, a scenario's tables, the rows of a call. */
#ifndef MEANFLOCK_LEARN_H
#define MEANFLOCK_LEARN_H

#include <stddef.h>
#include <stdint.h>

/* Files that end in _in_space.c compile the same code for three axes, under other names. */
#ifndef DIMENSIONS
#define DIMENSIONS 2
#endif
#if DIMENSIONS == 2
#define OF_AXES(name) name##_in_plane
#else
#define OF_AXES(name) name##_in_space
#endif
#define empirical OF_AXES(empirical)
#define step_one OF_AXES(step_one)
#define step_many OF_AXES(step_many)
#define step_most OF_AXES(step_most)

enum {
    VARIABLES = 2 * DIMENSIONS, POWERS = 7, ALL_POWERS = VARIABLES * POWERS,
    PER_AXIS = 27, VALUES = DIMENSIONS * PER_AXIS, BLOCKS = 4 * VALUES, /* σ_H and its three derivatives */
    PAIRS = DIMENSIONS == 2 ? 15 : 35, ALL_PAIRS = (2 + 3 * DIMENSIONS) * PAIRS,
    DENSITIES = DIMENSIONS == 2 ? 69 : 209, TERMS = DENSITIES + 1,
    WEIGHTS = 2 * VALUES + 2 * DENSITIES, PRODUCTS = DIMENSIONS == 2 ? 494 : 1819, NODES = 64, NUMBERS = DIMENSIONS + 3
};

/* The fields of layout.py in their order: first all doubles, from value_first on all indices. */
typedef struct {
    double scale[VARIABLES], value_factor[BLOCKS], pair_factor[ALL_PAIRS], coefficient[TERMS], factorial[TERMS];
    double monomials[TERMS * NODES], kernel[NODES], wind[DIMENSIONS];
    double drag, half_variance, c1, c2, c3, epsilon, gain, mu_h, mu_f, push, kappa, arrived_squared;
    int32_t value_first[BLOCKS], value_second[BLOCKS], pair_first[ALL_PAIRS], pair_second[ALL_PAIRS];
#if DIMENSIONS > 2
    int32_t pair_third[ALL_PAIRS];
#endif
    int32_t at_position[TERMS], at_velocity[TERMS], left[2 * DENSITIES], right[2 * DENSITIES];
    int32_t weight[PRODUCTS], term[PRODUCTS], starts[TERMS + 1];
} Tables;

/* Doubles, row after row, perhaps unaligned: VARIABLES, WEIGHTS and NUMBERS a row. */
typedef struct {
    const char *states, *weights;
    char *weights_out, *numbers; /* [a_x, a_y, e_H, e_F, φ_G] */
    int learns_density;
} Rows;

/* φ_G of one row: the mean of K over the n states that it knows (interaction.py). `products`: room for n doubles. */
double empirical(const Tables *t, const char *state, const char *known, ptrdiff_t n, double *products);

/* `learn` of learn.py for row `from`; where no density is learned, φ_G is among its numbers already. */
void step_one(const Tables *t, const Rows *rows, ptrdiff_t from, int count);

/* The same step for `count` rows from `from` on, at most MANY, if the processor has AVX2. */
void step_many(const Tables *t, const Rows *rows, ptrdiff_t from, int count);

/* The repulsion of one row, from its state and the n states that it knows, perhaps unaligned. `room`: axes · n doubles. */
void repel(int axes, const char *state, const char *known, ptrdiff_t n, double weight, double range, double *room,
           double *pushed);

/* The same step for MOST rows from `from` on, if the processor has AVX-512. */
void step_most(const Tables *t, const Rows *rows, ptrdiff_t from, int count);

#if defined(__x86_64__) && defined(__GNUC__)
#define MANY 4
#define MOST 8
#else
#define MANY 1 /* there is neither step_many nor step_most */
#endif

#endif
