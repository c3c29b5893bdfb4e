/* What the files of the module share: agent/kernel.c, agent/sides.c and agent/turn.c. */
#ifndef MEANFLOCK_TURN_H
#define MEANFLOCK_TURN_H

#include "tables.h"

/* What kernel.tables made, or NULL and an error. */
const Tables *tables_in(PyObject *capsule);

/* agent.learner.Learner.step of `count` rows. */
void step_rows(const Tables *t, const Rows *rows, Py_ssize_t count);

/* What the rows of a process have learned, on two sides: a tick goes from one to the other. */
typedef struct {
    PyObject_HEAD
    PyObject *capsule; /* of the tables */
    const Tables *tables;
    Py_ssize_t rows;
    double bound; /* no number that comes out is as large */
    int side, views; /* where the rows are now; buffers that are held */
    char *value[2], *density[2];
    Py_buffer view[4];
} Sides;

/* Adds the types `Sides` and `Turn`; or −1 and an error. */
int add_sides(PyObject *module);
int add_turn(PyObject *module);

/* Whether that is a Sides; or 0 and an error. */
int are_sides(PyObject *object);

#endif
