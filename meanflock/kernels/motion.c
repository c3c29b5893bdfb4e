/* What motion.py says: the same operations in the same order. */
#include "module.h"

#include <math.h>
#include <string.h>

enum { SIZE = 4, AXES = 2 }; /* of a state, kernels/state.py */

PyObject *motion_move(PyObject *module, PyObject *args) {
    PyObject *states, *acceleration, *noise, *wind, *moved;
    Arrays arrays = {.held = 0};
    double drag, shake, dt;
    if (!PyArg_ParseTuple(args, "OOOOdddO:move", &states, &acceleration, &noise, &wind, &drag, &shake, &dt, &moved))
        return NULL;
    const Py_ssize_t n = items(&arrays, states, "states", 1, SIZE);
    if (n < 0 || !doubles(&arrays, acceleration, "acceleration", n * AXES, READ)
        || !doubles(&arrays, noise, "noise", n * AXES, READ))
        return done(&arrays, NULL);
    const Py_ssize_t winds = items(&arrays, wind, "wind", 1, AXES);
    if (winds < 0 || !doubles(&arrays, moved, "moved", n * SIZE, WRITTEN)) return done(&arrays, NULL);
    if (winds != 1 && winds != n) {
        PyErr_SetString(PyExc_ValueError, "wind: not one, nor one for each UAV");
        return done(&arrays, NULL);
    }
    for (Py_ssize_t i = 0; i < n; i++) { /* arrays begin anywhere */
        double now[SIZE], pushed[AXES], drawn[AXES], air[AXES], next[SIZE];
        memcpy(now, (const char *)arrays.view[0].buf + i * SIZE * D, sizeof now);
        memcpy(pushed, (const char *)arrays.view[1].buf + i * AXES * D, sizeof pushed);
        memcpy(drawn, (const char *)arrays.view[2].buf + i * AXES * D, sizeof drawn);
        memcpy(air, (const char *)arrays.view[3].buf + (winds == 1 ? 0 : i) * AXES * D, sizeof air);
        for (int axis = 0; axis < AXES; axis++) {
            const double change = (pushed[axis] - (now[AXES + axis] - air[axis]) * drag) * dt;
            const double velocity = (now[AXES + axis] + change) + shake * drawn[axis];
            next[AXES + axis] = velocity;
            next[axis] = velocity * dt + now[axis];
        }
        memcpy((char *)arrays.view[4].buf + i * SIZE * D, next, sizeof next);
    }
    return done(&arrays, Py_NewRef(Py_None));
}

PyObject *motion_reached(PyObject *module, PyObject *args) {
    PyObject *states, *goals, *within;
    Arrays arrays = {.held = 0};
    double radius;
    if (!PyArg_ParseTuple(args, "OOdO:reached", &states, &goals, &radius, &within)) return NULL;
    const Py_ssize_t n = items(&arrays, states, "states", 1, SIZE);
    if (n < 0 || !doubles(&arrays, goals, "goals", n * SIZE, READ)
        || !sized(hold(&arrays, within, "within", "?", 1, WRITTEN), "within", n))
        return done(&arrays, NULL);
    char *inside = arrays.view[2].buf;
    Py_ssize_t count = 0;
    for (Py_ssize_t i = 0; i < n; i++) {
        double here[SIZE], goal[SIZE], squared = 0.0;
        memcpy(here, (const char *)arrays.view[0].buf + i * SIZE * D, sizeof here);
        memcpy(goal, (const char *)arrays.view[1].buf + i * SIZE * D, sizeof goal);
        for (int k = 0; k < SIZE; k++) squared += (here[k] - goal[k]) * (here[k] - goal[k]);
        inside[i] = inside[i] && sqrt(squared) <= radius;
        count += inside[i];
    }
    return done(&arrays, PyLong_FromSsize_t(count));
}
