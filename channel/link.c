/* What link.py, rician.py, account.py and air.py of this room say in NumPy: the same operations, so the same bits. */
#include "link.h"

#include <math.h>

ptrdiff_t carry(const Ahead *ahead, const Message *message, int begun, ptrdiff_t links, int64_t *slots,
                int64_t *missing, ptrdiff_t *room, ptrdiff_t *busy) {
    ptrdiff_t left = 0, used = 0;
    for (ptrdiff_t i = 0; i < links; i++) {
        if (!begun) slots[i] = 0, missing[i] = message->needed;
        room[left] = i;
        left += missing[i] > 0;
    }
    int64_t slot = left ? slots[room[0]] : message->most; /* who is busy has been so in every slot */
    while (left && slot < message->most && left <= ahead->slots - used) {
        const double *normal = ahead->normal + used * PATHS;
        ptrdiff_t still = 0;
        slot++;
        for (ptrdiff_t k = 0; k < left; k++, normal += PATHS) { /* without a branch: fading cannot be foreseen */
            const ptrdiff_t i = room[k];
            const double in_phase = normal[0] * ahead->chi + ahead->xi, quadrature = normal[1] * ahead->chi;
            const double squared = in_phase * in_phase + quadrature * quadrature;
            const int64_t lacks = missing[i] - (squared >= message->threshold[message->alike ? 0 : i]);
            slots[i] = slot;
            missing[i] = lacks;
            room[still] = i;
            still += lacks > 0;
        }
        used += left;
        left = still;
    }
    *busy = slot < message->most ? left : 0;
    return used;
}

Account account(const int32_t *template, int32_t tick, ptrdiff_t links, const int64_t *slots, const int64_t *missing,
                ptrdiff_t transmissions, const int64_t *first, int32_t *record) {
    Account sum = {0, 0, 0};
    for (ptrdiff_t k = 0; k < transmissions; k++) {
        const ptrdiff_t end = k + 1 < transmissions ? first[k + 1] : links;
        int64_t longest = slots[first[k]];
        for (ptrdiff_t i = first[k]; i < end; i++) longest = slots[i] > longest ? slots[i] : longest;
        sum.longest += longest;
    }
    for (ptrdiff_t i = 0; i < links; i++, template += COLUMNS, record += COLUMNS) {
        const int lost = missing[i] > 0;
        sum.outages += lost;
        sum.slots += slots[i];
        for (int column = 0; column < COLUMNS; column++) record[column] = template[column];
        record[TICK] = tick;
        record[SLOTS_OF] = (int32_t)(lost ? -slots[i] : slots[i]);
    }
    return sum;
}

int within(const double *states, ptrdiff_t uavs, double diagonal_squared) {
    double low[] = {INFINITY, INFINITY}, high[] = {-INFINITY, -INFINITY};
    int sane = 1;
    for (ptrdiff_t i = 0; i < uavs; i++)
        for (int axis = X; axis <= Y; axis++) {
            const double at = states[i * SIZE + axis];
            low[axis] = at < low[axis] ? at : low[axis];
            high[axis] = at > high[axis] ? at : high[axis];
            sane = sane && at == at;
        }
    const double along = high[X] - low[X], across = high[Y] - low[Y];
    return sane && along * along + across * across <= diagonal_squared;
}
