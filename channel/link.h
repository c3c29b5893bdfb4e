/* What the compiled radio works on: normal numbers drawn ahead, and the links of a batch. */
#ifndef MEANFLOCK_LINK_H
#define MEANFLOCK_LINK_H

#include <stddef.h>
#include <stdint.h>

enum { PATHS = 2 };                                       /* in phase, in quadrature */
enum { TICK = 0, SLOTS_OF = 4, COLUMNS = 5 };             /* of a record: tick, source, target, kind, slots */
enum { X = 0, Y = 1, SIZE = 4 };                          /* of a state */

/* PATHS standard normal numbers a slot, of `slots`; the amplitude of one is |ξ + χ(n₁ + jn₂)|. */
typedef struct {
    const double *normal;
    ptrdiff_t slots;
    double xi, chi;
} Ahead;

/* What K links need to carry a message: to reach a threshold of z², K or one for all, in `needed` of `most` slots. */
typedef struct {
    const double *threshold;
    int alike;
    int64_t needed, most;
} Message;

typedef struct {
    int64_t outages, slots, longest;
} Account;

/* Carries a message as far as what was drawn ahead goes: returns of how many slots that was used, and writes how many
 * links are busy, 0 where the message is through or given up. Of K links each: slots spent, slots missing, and room. */
ptrdiff_t carry(const Ahead *ahead, const Message *message, int begun, ptrdiff_t links, int64_t *slots,
                int64_t *missing, ptrdiff_t *room, ptrdiff_t *busy);

/* The records of K links, COLUMNS each, and what they cost together. `first`: of each transmission. */
Account account(const int32_t *template, int32_t tick, ptrdiff_t links, const int64_t *slots, const int64_t *missing,
                ptrdiff_t transmissions, const int64_t *first, int32_t *record);

/* Whether a box around these positions has no longer diagonal. */
int within(const double *states, ptrdiff_t uavs, double diagonal_squared);

#endif
