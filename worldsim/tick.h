/* What the compiled tick of the world works on: a scenario's constants and the arrays of one swarm. */
#ifndef MEANFLOCK_TICK_H
#define MEANFLOCK_TICK_H

#include <stddef.h>
#include <stdint.h>

enum { SIZE = 4, AXES = 2, OUTCOME = AXES + 3, NUMBERS = 3, COLUMNS = SIZE + 2 };
enum { FLYING = 0, LOST = 2 };                        /* swarm.messages.Status */
enum { DIVERGED = 1, ARRIVING = 2, COLLIDING = 4 };   /* marks of a UAV, worldsim/physics.py */

/* In the order in which worldsim/kernel.py lists them; doubles only. */
typedef struct {
    double wind[AXES], drag, dt, shake; /* shake: σ_wind √dt */
    double induced, tip_squared, blade_power, induced_power, parasite_drag; /* induced: 2 χ_o² */
    double bound, destination, hazard_squared, collision_squared;
} Constants;

/* N UAVs; SIZE doubles a UAV of states and moved, AXES of the next three, of which gust may be NULL; NUMBERS a swarm. */
typedef struct {
    const double *states, *accelerations, *gust, *noise;
    const uint8_t *status;
    double *moved, *energy, *distance, *speed_sum, *numbers;
    int64_t *ticks_on_way;
    uint8_t *marks;
} Swarm;

/* One tick of n UAVs, returns which marks there are. Room for n · COLUMNS doubles; and for n² where all pairs are to be
 * measured, NULL where not. */
int tick(const Constants *c, const Swarm *s, ptrdiff_t n, double *columns, double *matrix);

/* Root-mean-square distance of n models of so many doubles from their mean; −1 where a weight is not below the bound.
 * Room for 2 · width + n doubles. */
double spread(const double *models, ptrdiff_t n, ptrdiff_t width, double bound, double *room);

/* Of all pairs i < j of n points in a plane, each row added up, and then the rows. Room for 2 n doubles. */
double sum_of_distances(ptrdiff_t n, const double *x, const double *y, double *room);

/* Of n points, x ascending: how many pairs are at most `most` apart, squared; those less than `least`, squared, are told
 * one by one, i < j. None of either is farther apart along x than `reach`. −1 where what is told returns 0. */
typedef int (*Found)(void *list, ptrdiff_t i, ptrdiff_t j);
int64_t near_pairs(ptrdiff_t n, const double *x, const double *y, double reach, double most, double least, Found found,
                   void *list);

#endif
