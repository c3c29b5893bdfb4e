/* Functions of the extension for the mean-field methods, in the plane and in space. */
#include "../module.h" /* Python.h comes first */

#include <string.h>

#include "../axes.h"
#include "learn.h"

PyObject *learner_tables_in_plane(PyObject *module, PyObject *args);
PyObject *learner_tables_in_space(PyObject *module, PyObject *args);
PyObject *learner_step_in_plane(PyObject *module, PyObject *args);
PyObject *learner_step_in_space(PyObject *module, PyObject *args);
Py_ssize_t numbers_in_space(void);

PyObject *learner_tables(PyObject *module, PyObject *args) {
    const Py_ssize_t numbers = PyTuple_Size(args) > 0 ? PyObject_Size(PyTuple_GetItem(args, 0)) : 0;
    PyErr_Clear(); /* an argument without a size is refused below */
    return (numbers == numbers_in_space() ? learner_tables_in_space : learner_tables_in_plane)(module, args);
}

PyObject *learner_step(PyObject *module, PyObject *args) {
    PyObject *capsule = PyTuple_Size(args) > 0 ? PyTuple_GetItem(args, 0) : NULL;
    const int is_space = capsule != NULL && PyCapsule_IsValid(capsule, "meanflock.tables_in_space");
    return (is_space ? learner_step_in_space : learner_step_in_plane)(module, args);
}

PyObject *learner_repel(PyObject *module, PyObject *args) {
    PyObject *states, *known, *pushed;
    Arrays arrays = {.held = 0};
    double weight, range, *room;
    int axes;
    if (!PyArg_ParseTuple(args, "OOddO:repel", &states, &known, &weight, &range, &pushed)) return NULL;
    const Py_ssize_t rows = rows_of(&arrays, states, "states", 2, &axes);
    const Py_ssize_t others = rows < 0 ? -1 : items(&arrays, known, "known", rows, 2 * axes);
    if (others < 0 || !doubles(&arrays, pushed, "pushed", rows * axes, WRITTEN)
        || (room = room_for(&arrays, axes * others)) == NULL)
        return done(&arrays, NULL);
    for (Py_ssize_t m = 0; m < rows; m++) {
        const char *state = (const char *)arrays.view[0].buf + m * 2 * axes * D;
        double found[MOST_AXES];
        repel(axes, state, (const char *)arrays.view[1].buf + m * others * 2 * axes * D, others, weight, range, room, found);
        memcpy((char *)arrays.view[2].buf + m * axes * D, found, axes * D);
    }
    return done(&arrays, Py_NewRef(Py_None));
}
