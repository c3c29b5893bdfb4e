/* What worldsim/physics.py says in NumPy, for one swarm: the same operations in the same order, so the same bits.
 *
 * By columns (all x, all y, …), which the compiler turns into vectors; what is decided UAV by UAV stands apart.
 */
#define LANES 1
#include <math.h>

#include "../swarm/pairwise.h"
#include "tick.h"

/* dynamics.step, and who leaves every bound stays where it was. */
static int move(const Constants *c, const Swarm *s, ptrdiff_t n, double *columns) {
    int any = 0;
    for (ptrdiff_t i = 0; i < n; i++) {
        const double *state = s->states + i * SIZE;
        double *moved = s->moved + i * SIZE;
        int sane = 1;
        for (int x = 0; x < AXES; x++) {
            double velocity = state[AXES + x], asked = s->status[i] == LOST ? 0.0 : s->accelerations[i * AXES + x];
            if (s->gust != NULL) asked += s->gust[i * AXES + x];
            velocity += (asked - (velocity - c->wind[x]) * c->drag) * c->dt;
            velocity += c->shake * s->noise[i * AXES + x];
            moved[AXES + x] = velocity;
            moved[x] = velocity * c->dt + state[x];
            sane = sane && fabs(moved[x]) < c->bound && fabs(velocity) < c->bound; /* NaN is below nothing */
        }
        s->marks[i] = sane ? 0 : DIVERGED;
        any |= s->marks[i];
        for (int x = 0; x < AXES && !sane; x++) {
            moved[x] = state[x];
            moved[AXES + x] = 0.0;
        }
        for (int k = 0; k < SIZE; k++) columns[k * n + i] = moved[k];
    }
    return any;
}

/* state.speed, state.norm and energy.power. */
static TARGET void spend(const Constants *c, ptrdiff_t n, const double *__restrict columns, double *__restrict energy,
                  double *__restrict speed, double *__restrict away) {
    const double *x = columns, *y = x + n, *vx = y + n, *vy = vx + n;
    for (ptrdiff_t i = 0; i < n; i++) {
        double v = sqrt(vx[i] * vx[i] + vy[i] * vy[i]), squared = v * v, induced = squared / c->induced;
        double blade = c->blade_power * (1.0 + 3.0 * squared / c->tip_squared);
        double lift = c->induced_power / sqrt(sqrt(1.0 + induced * induced) + induced);
        energy[i] += (blade + lift + c->parasite_drag * squared * v / 2.0) * c->dt;
        speed[i] = v;
        away[i] = sqrt(x[i] * x[i] + y[i] * y[i] + vx[i] * vx[i] + vy[i] * vy[i]);
    }
}

/* The books of who is on the way, and who arrives; returns the highest speed. */
static double account(const Constants *c, const Swarm *s, ptrdiff_t n, const double *speed, const double *away, int *any) {
    double most = 0.0;
    for (ptrdiff_t i = 0; i < n; i++) {
        if (s->status[i] != FLYING) continue;
        s->speed_sum[i] += speed[i];
        s->ticks_on_way[i] += 1;
        s->distance[i] += speed[i] * c->dt;
        if (speed[i] > most) most = speed[i];
        if (away[i] <= c->destination && !s->marks[i]) s->marks[i] = ARRIVING;
        *any |= s->marks[i];
    }
    return most;
}

/* By rows, all N² distances of points (x, y). */
static TARGET void distances(ptrdiff_t n, const double *__restrict x, const double *__restrict y, double *__restrict matrix) {
    for (ptrdiff_t i = 0; i < n; i++)
        for (ptrdiff_t j = 0; j < n; j++) {
            double along = x[i] - x[j], across = y[i] - y[j];
            matrix[i * n + j] = sqrt(along * along + across * across);
        }
}

/* How many pairs i < j are at most `most` apart, and at all less than `least`; both squared. */
static TARGET void count(ptrdiff_t n, const double *__restrict x, const double *__restrict y, double most, double least,
                  int64_t *near, int64_t *touching) {
    int64_t within = 0, closer = 0;
    for (ptrdiff_t i = 0; i < n; i++)
        for (ptrdiff_t j = i + 1; j < n; j++) {
            double along = x[i] - x[j], across = y[i] - y[j], squared = along * along + across * across;
            within += squared <= most;
            closer += squared < least;
        }
    *near = within;
    *touching = closer;
}

/* Marks who collides while both are on the way. */
static int collide(const Constants *c, const Swarm *s, ptrdiff_t n, const double *x, const double *y) {
    int any = 0;
    for (ptrdiff_t i = 0; i < n; i++)
        for (ptrdiff_t j = i + 1; j < n; j++) {
            double along = x[i] - x[j], across = y[i] - y[j];
            if (!(along * along + across * across < c->collision_squared)) continue;
            if (s->status[i] != FLYING || s->status[j] != FLYING) continue;
            s->marks[i] |= COLLIDING;
            s->marks[j] |= COLLIDING;
            any = COLLIDING;
        }
    return any;
}

int tick(const Constants *c, const Swarm *s, ptrdiff_t n, double *columns, double *matrix) {
    double *x = columns, *y = x + n, *vx = y + n, *vy = vx + n, *speed = vy + n, *away = speed + n;
    int any = move(c, s, n, columns);
    spend(c, n, columns, s->energy, speed, away);
    s->numbers[0] = account(c, s, n, speed, away, &any);
    if (matrix == NULL) return any;
    int64_t near, touching;
    distances(n, vx, vy, matrix);
    count(n, x, y, c->hazard_squared, c->collision_squared, &near, &touching);
    s->numbers[1] = sum_of(matrix, n * n) / (double)(n * n);
    s->numbers[2] = (double)near;
    return touching ? any | collide(c, s, n, x, y) : any;
}
