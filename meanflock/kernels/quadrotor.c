/* What quadrotor.py says: the same operations in the same order, for ROWS rows at a time, a row a lane. */
#include "module.h" /* Python.h comes first */

#include <math.h>
#include <string.h>

#include "pairwise.h"

enum { ROWS = 8, STATE = 6, BODY = 12, VECTOR = 3 };

static const double GRAVITY = 9.81, UNIT = 1e-6;

typedef struct { /* the fields of quadrotor.Craft in their order */
    double mass, jx, jy, jz, arm, k, k_m, lag, speed_max, k_p, k_d, drag, step;
} Craft;

/* Columns of ROWS rows. */
typedef struct {
    double state[STATE][ROWS], body[BODY][ROWS], wanted[VECTOR][ROWS], outside[VECTOR][ROWS];
} Block;

INLINE double within(double force, double most) {
    force = force > 0.0 ? force : 0.0;
    return force < most ? force : most;
}

TARGET static void fly(const Craft *c, Block *b, long steps) {
    const double m = c->mass, jx = c->jx, jy = c->jy, jz = c->jz, k = c->k, k_m = c->k_m, lag = c->lag;
    const double k_p = c->k_p, k_d = c->k_d, drag = c->drag, h = c->step;
    const double reach = c->arm * sqrt(0.5), ratio = k_m / k, most = k * (c->speed_max * c->speed_max), half = 0.5 * h, quarter = 0.25 * h;
    const double tilt_share = 0.25 / reach, yaw_share = 0.25 / ratio, of_k = 1 / k, of_m = 1 / m;
    const double of_jx = 1 / jx, of_jy = 1 / jy, of_jz = 1 / jz;
    double force[3][ROWS], to[3][ROWS], second[2][ROWS], first[3][ROWS], spent[ROWS];
    for (int i = 0; i < ROWS; i++) {
        const double up = b->wanted[2][i] + GRAVITY;
        const double fx = m * b->wanted[0][i], fy = m * b->wanted[1][i], fz = m * (up > 0.0 ? up : 0.0);
        const double length = sqrt(fx * fx + fy * fy + fz * fz);
        const int pulls = length > 1e-9 * m;
        const double cx = pulls ? fx / length : 0.0, cy = pulls ? fy / length : 0.0, cz = pulls ? fz / length : 1.0;
        const double across = sqrt(cz * cz + cy * cy);
        const int turns = across > 1e-6;
        const double dy = turns ? cz / across : 1.0, dz = turns ? -cy / across : 0.0;
        force[0][i] = fx, force[1][i] = fy, force[2][i] = fz, to[0][i] = cx, to[1][i] = cy, to[2][i] = cz;
        second[0][i] = dy, second[1][i] = dz;
        first[0][i] = dy * cz - dz * cy, first[1][i] = dz * cx, first[2][i] = -dy * cx;
        spent[i] = 0.0;
    }
    for (long t = 0; t < steps; t++)
        for (int i = 0; i < ROWS; i++) {
            const double vx = b->state[3][i], vy = b->state[4][i], vz = b->state[5][i];
            const double qw = b->body[0][i], qx = b->body[1][i], qy = b->body[2][i], qz = b->body[3][i];
            const double wx = b->body[4][i], wy = b->body[5][i], wz = b->body[6][i];
            const double cx = to[0][i], cy = to[1][i], cz = to[2][i], dy = second[0][i], dz = second[1][i];
            const double ex = first[0][i], ey = first[1][i], ez = first[2][i];
            const double r11 = 1.0 - 2.0 * (qy * qy + qz * qz), r12 = 2.0 * (qx * qy - qw * qz);
            const double r13 = 2.0 * (qx * qz + qw * qy), r21 = 2.0 * (qx * qy + qw * qz);
            const double r22 = 1.0 - 2.0 * (qx * qx + qz * qz), r23 = 2.0 * (qy * qz - qw * qx);
            const double r31 = 2.0 * (qx * qz - qw * qy), r32 = 2.0 * (qy * qz + qw * qx);
            const double r33 = 1.0 - 2.0 * (qx * qx + qy * qy);
            const double thrust = within(force[0][i] * r13 + force[1][i] * r23 + force[2][i] * r33, 4.0 * most);
            const double e1 = 0.5 * ((cx * r12 + cy * r22 + cz * r32) - (r23 * dy + r33 * dz));
            const double e2 = 0.5 * ((ex * r13 + ey * r23 + ez * r33) - (r11 * cx + r21 * cy + r31 * cz));
            const double e3 = 0.5 * ((dy * r21 + dz * r31) - (r12 * ex + r22 * ey + r32 * ez));
            const double gx = (jz - jy) * wy * wz, gy = (jx - jz) * wz * wx, gz = (jy - jx) * wx * wy;
            const double u1 = tilt_share * (gx - jx * (k_p * e1 + k_d * wx));
            const double u2 = tilt_share * (gy - jy * (k_p * e2 + k_d * wy));
            const double u3 = yaw_share * (gz - jz * (k_p * e3 + k_d * wz)), u0 = 0.25 * thrust;
            double o1 = b->body[7][i], o2 = b->body[8][i], o3 = b->body[9][i], o4 = b->body[10][i];
            const double b1 = o1 * o1, b2 = o2 * o2, b3 = o3 * o3, b4 = o4 * o4;
            o1 = o1 + lag * (sqrt(within(u0 + u1 - u2 + u3, most) * of_k) - o1);
            o2 = o2 + lag * (sqrt(within(u0 - u1 - u2 - u3, most) * of_k) - o2);
            o3 = o3 + lag * (sqrt(within(u0 - u1 + u2 + u3, most) * of_k) - o3);
            o4 = o4 + lag * (sqrt(within(u0 + u1 + u2 - u3, most) * of_k) - o4);
            const double a1 = o1 * o1, a2 = o2 * o2, a3 = o3 * o3, a4 = o4 * o4;
            const double s1 = 0.5 * (b1 + a1), s2 = 0.5 * (b2 + a2), s3 = 0.5 * (b3 + a3), s4 = 0.5 * (b4 + a4);
            const double t1 = (k * reach) * ((s1 - s2) - s3 + s4), t2 = (k * reach) * ((s3 - s1) - s2 + s4);
            const double t3 = k_m * ((s1 - s2) + s3 - s4), pull = (k * of_m) * (((s1 + s2) + s3) + s4);
            const double next_vx = vx + h * (pull * r13 + b->outside[0][i] - drag * vx);
            const double next_vy = vy + h * (pull * r23 + b->outside[1][i] - drag * vy);
            const double next_vz = vz + h * (pull * r33 + b->outside[2][i] - GRAVITY - drag * vz);
            b->state[0][i] = b->state[0][i] + half * (vx + next_vx);
            b->state[1][i] = b->state[1][i] + half * (vy + next_vy);
            b->state[2][i] = b->state[2][i] + half * (vz + next_vz);
            b->state[3][i] = next_vx, b->state[4][i] = next_vy, b->state[5][i] = next_vz;
            const double next_wx = wx + h * ((t1 - gx) * of_jx), next_wy = wy + h * ((t2 - gy) * of_jy);
            const double next_wz = wz + h * ((t3 - gz) * of_jz);
            const double hx = quarter * (wx + next_wx), hy = quarter * (wy + next_wy), hz = quarter * (wz + next_wz);
            const double nw = qw - hx * qx - hy * qy - hz * qz, nx = qx + hx * qw + hz * qy - hy * qz;
            const double ny = qy + hy * qw - hz * qx + hx * qz, nz = qz + hz * qw + hy * qx - hx * qy;
            const double shrink = 1.0 / sqrt(nw * nw + nx * nx + ny * ny + nz * nz);
            b->body[0][i] = nw * shrink, b->body[1][i] = nx * shrink, b->body[2][i] = ny * shrink;
            b->body[3][i] = nz * shrink, b->body[4][i] = next_wx, b->body[5][i] = next_wy, b->body[6][i] = next_wz;
            b->body[7][i] = o1, b->body[8][i] = o2, b->body[9][i] = o3, b->body[10][i] = o4;
            spent[i] = spent[i] + (((o1 * a1 + o2 * a2) + o3 * a3) + o4 * a4);
        }
    for (int i = 0; i < ROWS; i++) b->body[11][i] = (k_m / (double)steps) * spent[i];
}

/* Copies `width` numbers of `count` rows into columns; the lanes that are left repeat the first row. */
static void take(double (*column)[ROWS], const char *rows, Py_ssize_t from, Py_ssize_t count, int width) {
    for (int i = 0; i < ROWS; i++)
        for (int k = 0; k < width; k++)
            memcpy(&column[k][i], rows + ((from + (i < count ? i : 0)) * width + k) * D, D);
}

static void give(double (*column)[ROWS], char *rows, Py_ssize_t from, Py_ssize_t count, int width) {
    for (int i = 0; i < count; i++)
        for (int k = 0; k < width; k++) memcpy(rows + ((from + i) * width + k) * D, &column[k][i], D);
}

/* Returns the first row whose attitude is no unit quaternion, or -1. */
static Py_ssize_t no_attitude(const char *body, Py_ssize_t rows) {
    for (Py_ssize_t n = 0; n < rows; n++) {
        double q[4];
        memcpy(q, body + n * BODY * D, sizeof q);
        if (!(fabs((q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]) - 1.0) <= UNIT)) return n;
    }
    return -1;
}

PyObject *quadrotor_fly(PyObject *module, PyObject *args) {
    PyObject *craft, *states, *body, *wanted, *outside, *moved, *turned;
    Arrays arrays = {.held = 0};
    Craft c;
    Block b;
    long steps;
    if (!PyArg_ParseTuple(args, "OOOOOlOO:fly", &craft, &states, &body, &wanted, &outside, &steps, &moved, &turned))
        return NULL;
    const Py_ssize_t n = items(&arrays, states, "states", 1, STATE);
    if (n < 0 || !doubles(&arrays, body, "body", n * BODY, READ) || !doubles(&arrays, wanted, "wanted", n * VECTOR, READ)
        || !doubles(&arrays, outside, "outside", n * VECTOR, READ)
        || !doubles(&arrays, craft, "craft", sizeof c / D, READ)
        || !doubles(&arrays, moved, "moved", n * STATE, WRITTEN) || !doubles(&arrays, turned, "turned", n * BODY, WRITTEN))
        return done(&arrays, NULL);
    const Py_buffer *of = arrays.view;
    const Py_ssize_t bad = no_attitude(of[1].buf, n);
    if (bad >= 0) {
        PyErr_Format(PyExc_ValueError, "body: the attitude of row %zd is no unit quaternion", bad);
        return done(&arrays, NULL);
    }
    memcpy(&c, of[4].buf, sizeof c);
    for (Py_ssize_t from = 0; from < n; from += ROWS) {
        const Py_ssize_t count = n - from < ROWS ? n - from : ROWS;
        take(b.state, of[0].buf, from, count, STATE);
        take(b.body, of[1].buf, from, count, BODY);
        take(b.wanted, of[2].buf, from, count, VECTOR);
        take(b.outside, of[3].buf, from, count, VECTOR);
        fly(&c, &b, steps);
        give(b.state, of[5].buf, from, count, STATE);
        give(b.body, of[6].buf, from, count, BODY);
    }
    return done(&arrays, Py_NewRef(Py_None));
}
