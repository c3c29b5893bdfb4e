/* What motion.py says: the same operations in the same order. */
#include "module.h" /* Python.h comes first */

#include <math.h>
#include <string.h>

#include "axes.h"

typedef struct { /* arguments as in motion.py; arrays begin anywhere */
    const char *states, *acceleration, *noise, *wind;
    char *moved;
    Py_ssize_t rows, winds;
    double drag, shake, dt;
} Motion;

FOR_AXES void move(const int axes, const Motion *m) {
    const size_t vector = axes * sizeof(double), state = 2 * vector;
    for (Py_ssize_t i = 0; i < m->rows; i++) {
        double now[2 * MOST_AXES], pushed[MOST_AXES], drawn[MOST_AXES], air[MOST_AXES], next[2 * MOST_AXES];
        memcpy(now, m->states + i * state, state);
        memcpy(pushed, m->acceleration + i * vector, vector);
        memcpy(drawn, m->noise + i * vector, vector);
        memcpy(air, m->wind + (m->winds == 1 ? 0 : i) * vector, vector);
        for (int axis = 0; axis < axes; axis++) {
            const double change = (pushed[axis] - (now[axes + axis] - air[axis]) * m->drag) * m->dt;
            const double velocity = (now[axes + axis] + change) + m->shake * drawn[axis];
            next[axes + axis] = velocity;
            next[axis] = velocity * m->dt + now[axis];
        }
        memcpy(m->moved + i * state, next, state);
    }
}

PyObject *motion_move(PyObject *module, PyObject *args) {
    PyObject *states, *acceleration, *noise, *wind, *moved;
    Arrays arrays = {.held = 0};
    Motion m;
    int axes;
    if (!PyArg_ParseTuple(args, "OOOOdddO:move", &states, &acceleration, &noise, &wind, &m.drag, &m.shake, &m.dt, &moved))
        return NULL;
    const Py_ssize_t n = rows_of(&arrays, states, "states", 2, &axes);
    if (n < 0 || !doubles(&arrays, acceleration, "acceleration", n * axes, READ)
        || !doubles(&arrays, noise, "noise", n * axes, READ))
        return done(&arrays, NULL);
    const Py_ssize_t winds = items(&arrays, wind, "wind", 1, axes);
    if (winds < 0 || !doubles(&arrays, moved, "moved", n * 2 * axes, WRITTEN)) return done(&arrays, NULL);
    if (winds != 1 && winds != n) {
        PyErr_SetString(PyExc_ValueError, "wind: not one, nor one for each UAV");
        return done(&arrays, NULL);
    }
    m.states = arrays.view[0].buf, m.acceleration = arrays.view[1].buf, m.noise = arrays.view[2].buf;
    m.wind = arrays.view[3].buf, m.moved = arrays.view[4].buf;
    m.rows = n, m.winds = winds;
    BY_AXES(axes, move, &m);
    return done(&arrays, Py_NewRef(Py_None));
}

/* Clears the rows that are not at their goals; returns how many are left. */
FOR_AXES Py_ssize_t at_goals(const int axes, Py_ssize_t rows, const char *states, const char *goals, double radius,
                             char *inside) {
    const size_t state = 2 * axes * sizeof(double);
    Py_ssize_t count = 0;
    for (Py_ssize_t i = 0; i < rows; i++) {
        double here[2 * MOST_AXES], goal[2 * MOST_AXES], squared = 0.0;
        memcpy(here, states + i * state, state);
        memcpy(goal, goals + i * state, state);
        for (int k = 0; k < 2 * axes; k++) squared += (here[k] - goal[k]) * (here[k] - goal[k]);
        inside[i] = inside[i] && sqrt(squared) <= radius;
        count += inside[i];
    }
    return count;
}

PyObject *motion_reached(PyObject *module, PyObject *args) {
    PyObject *states, *goals, *within;
    Arrays arrays = {.held = 0};
    double radius;
    int axes;
    if (!PyArg_ParseTuple(args, "OOdO:reached", &states, &goals, &radius, &within)) return NULL;
    const Py_ssize_t n = rows_of(&arrays, states, "states", 2, &axes);
    if (n < 0 || !doubles(&arrays, goals, "goals", n * 2 * axes, READ)
        || !sized(hold(&arrays, within, "within", "?", 1, WRITTEN), "within", n))
        return done(&arrays, NULL);
    const Py_buffer *view = arrays.view;
    const Py_ssize_t left = BY_AXES(axes, at_goals, n, view[0].buf, view[1].buf, radius, view[2].buf);
    return done(&arrays, PyLong_FromSsize_t(left));
}
