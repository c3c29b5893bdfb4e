/* What the two halves of the module share: agent/kernel.c and agent/turn.c. */
#ifndef MEANFLOCK_TURN_H
#define MEANFLOCK_TURN_H

#include "tables.h"

/* What kernel.tables made, or NULL and an error. */
const Tables *tables_in(PyObject *capsule);

/* agent.learner.Learner.step of `count` rows. */
void step_rows(const Tables *t, const Rows *rows, Py_ssize_t count);

/* The type `Turn`. */
extern PyType_Spec turn_spec;

#endif
