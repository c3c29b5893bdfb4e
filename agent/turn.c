/* A plain tick from the bytes of a Sense to those of an Act (agent/reflex.py), in one call without a Python object but
 * these: all else it works on is found, checked and held once.
 */
#include "message.h"

#include <math.h>
#include <string.h>

#include "models.h"
#include "turn.h"

enum { NAME = 4, PLACE = sizeof(Py_ssize_t) }; /* bytes */

typedef struct { Message sense, act; int brings; } Kind; /* whether a Sense brings a model */

typedef struct {
    PyObject_HEAD
    Sides *sides;
    Kind *kinds; /* their texts come behind them */
    Py_ssize_t count;
    Text gap[GAPS]; /* as large as they are */
    Models models;
    Py_ssize_t uploads; /* how many models an Act says, or whose they are */
    char *names; /* what the rows are called */
} Turn;

static void turn_dealloc(PyObject *self) {
    Turn *turn = (Turn *)self;
    PyTypeObject *type = Py_TYPE(self);
    PyMem_Free(turn->names);
    PyMem_Free(turn->models.heard);
    PyMem_Free(turn->kinds);
    Py_XDECREF((PyObject *)turn->sides);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DECREF(type);
}

/* ---- What it is made of ---- */

static int refused(const char *why) {
    PyErr_Format(PyExc_ValueError, "a turn whose %s", why);
    return -1;
}

static int take_sizes(Turn *turn, const char *names, Py_ssize_t size) {
    Models *models = &turn->models;
    const Py_ssize_t rows = models->rows = turn->sides->rows;
    if (models->count && !models_travel(models)) return refused("models do not travel like this");
    if (size && size != rows * NAME) return refused("names are not those of its rows");
    if ((turn->names = PyMem_Malloc(size + 1)) == NULL) return PyErr_NoMemory(), -1;
    memcpy(turn->names, names, size);
    turn->gap[STATES].size = rows * SIZE * D;
    turn->gap[MODELS].size = models->count * (models->last - models->first) * models->item;
    turn->gap[OUTCOME].size = rows * NUMBERS * D;
    turn->gap[SOURCE].size = size ? models->count * NAME : 0;
    turn->gap[REPORT].size = rows * MODEL * D;
    return 0;
}

/* The place of the first gap for that, or −1. */
static int first(const Message *message, int gap) {
    int k = 0;
    while (message->piece[k].gap != gap && message->piece[k].gap != GAPS) k++;
    return message->piece[k].gap == gap ? k : -1;
}

static int once(const Message *message, int gap) {
    int times = 0;
    for (const Piece *piece = message->piece; piece->gap != GAPS; piece++) times += piece->gap == gap;
    return times == 1;
}

static int read_kind(Turn *turn, PyObject *pair, Kind *kind) {
    const int models = turn->models.count > 0, names = turn->gap[SOURCE].size > 0;
    const int asked[GAPS] = {[TICK] = 1, [NUMBER] = 1, [STATES] = 1, [MODELS] = turn->models.count == 1};
    const int said[GAPS] = {[TICK] = 1, [NUMBER] = 1, [MODELS] = models, [OUTCOME] = 1, [SOURCE] = names, [REPORT] = 1};
    PyObject *sense, *act;
    if (!PyTuple_Check(pair)) return PyErr_SetString(PyExc_TypeError, "a kind is a tuple"), -1;
    if (!PyArg_ParseTuple(pair, "OO:kind", &sense, &act) || read_template(sense, asked, &kind->sense) < 0
        || read_template(act, said, &kind->act) < 0)
        return -1;
    if (!once(&kind->sense, STATES)) return refused("Senses have not the states once");
    if (!once(&kind->act, OUTCOME)) return refused("Acts have not the outcome once");
    const int report = first(&kind->act, REPORT);
    if (report >= 0 && report < first(&kind->act, OUTCOME)) return refused("Acts report before there is an outcome");
    kind->brings = first(&kind->sense, MODELS) >= 0;
    if (first(&kind->act, MODELS) >= 0 || first(&kind->act, SOURCE) >= 0) turn->uploads = turn->models.count;
    return 0;
}

static int take_kinds(Turn *turn, PyObject *kinds) {
    const Py_ssize_t count = turn->count = PyTuple_Size(kinds);
    Models *models = &turn->models;
    Py_ssize_t texts = 0;
    int brings = 0;
    if ((turn->kinds = PyMem_Calloc(count, sizeof *turn->kinds)) == NULL) return PyErr_NoMemory(), -1;
    for (Py_ssize_t k = 0; k < count; k++) {
        Kind *kind = &turn->kinds[k];
        if (read_kind(turn, PyTuple_GetItem(kinds, k), kind) < 0) return -1;
        texts += kind->sense.texts + kind->act.texts;
        brings |= kind->brings;
    }
    Kind *held = PyMem_Realloc(turn->kinds, count * sizeof *held + texts);
    if (held == NULL) return PyErr_NoMemory(), -1;
    char *block = (char *)((turn->kinds = held) + count);
    for (Kind *kind = held; kind < held + count; kind++) block = gather(&kind->act, gather(&kind->sense, block));
    if (brings && (models->heard = PyMem_Calloc(models->rows, (models->last - models->first) * D)) == NULL)
        return PyErr_NoMemory(), -1;
    return 0;
}

static PyObject *turn_new(PyTypeObject *type, PyObject *args, PyObject *named) {
    PyObject *sides, *kinds;
    Models models = {0};
    const char *names = "";
    Py_ssize_t size = 0;
    if (named != NULL && PyDict_Size(named)) return PyErr_Format(PyExc_TypeError, "Turn takes no keyword arguments");
    if (!PyArg_ParseTuple(args, "OO!|n(nnnd)y#:Turn", &sides, &PyTuple_Type, &kinds, &models.count, &models.first,
                          &models.last, &models.item, &models.largest, &names, &size)
        || !are_sides(sides))
        return NULL;
    Turn *turn = (Turn *)((allocfunc)PyType_GetSlot(type, Py_tp_alloc))(type, 0); /* all zeros */
    if (turn == NULL) return NULL;
    Py_INCREF(sides);
    turn->sides = (Sides *)sides;
    turn->models = models;
    if (take_sizes(turn, names, size) < 0 || take_kinds(turn, kinds) < 0) Py_CLEAR(turn);
    return (PyObject *)turn;
}

/* ---- A tick ---- */

/* Steps the rows and writes the Act that says so; NULL, without an error, where a number is not below its bound. */
static PyObject *act_on(const Turn *turn, const Message *act, const Text *gap, Rows *rows, const char *places) {
    const Sides *sides = turn->sides;
    PyObject *bytes = PyBytes_FromStringAndSize(NULL, size_of(act, gap));
    if (bytes == NULL) return NULL;
    char *end = PyBytes_AsString(bytes);
    int sound = 1;
    for (const Piece *piece = act->piece; sound; piece++) {
        memcpy(end, piece->text.text, piece->text.size);
        end += piece->text.size;
        if (piece->gap == GAPS) return bytes;
        switch (piece->gap) {
        case OUTCOME:
            rows->numbers = end;
            step_rows(sides->tables, rows, sides->rows);
            sound = below(sides->bound, end, sides->rows * NUMBERS);
            break;
        case MODELS: sound = upload_models(&turn->models, rows, places, end); break;
        case SOURCE:
            for (Py_ssize_t k = 0; k < turn->uploads; k++)
                memcpy(end + k * NAME, turn->names + place_at(places, k) * NAME, NAME);
            break;
        case REPORT: report_models(&turn->models, rows, end); break;
        default: memcpy(end, gap[piece->gap].text, gap[piece->gap].size); /* TICK, NUMBER */
        }
        end += gap[piece->gap].size;
    }
    Py_DECREF(bytes);
    return NULL;
}

/* The places of the rows that upload; NULL and an error if they are none of these rows, or not as many. */
static const char *places_in(const Turn *turn, PyObject *bytes) {
    char *places = "";
    Py_ssize_t size = 0;
    if (bytes != NULL && PyBytes_AsStringAndSize(bytes, &places, &size) < 0) return NULL;
    int inside = size == turn->uploads * PLACE;
    for (Py_ssize_t k = 0; inside && k < turn->uploads; k++)
        inside = place_at(places, k) >= 0 && place_at(places, k) < turn->sides->rows;
    if (!inside) PyErr_SetString(PyExc_ValueError, "these are not the places of those that upload");
    return inside ? places : NULL;
}

static PyObject *turn_answer(PyObject *self, PyObject *const *args, Py_ssize_t count) {
    Turn *turn = (Turn *)self;
    Sides *sides = turn->sides;
    Text raw, gap[GAPS];
    char *bytes, digits[2][WIDEST];
    if (count < 2 || count > 4) return PyErr_Format(PyExc_TypeError, "answer takes 2 to 4 arguments, %zd given", count);
    if (PyBytes_AsStringAndSize(args[0], &bytes, &raw.size) < 0) return NULL;
    raw.text = bytes;
    memcpy(gap, turn->gap, sizeof gap);
    for (int k = 0; k < 2; k++) {
        const unsigned long long number = k + 1 < count ? PyLong_AsUnsignedLongLong(args[k + 1]) : 0;
        if (number == (unsigned long long)-1 && PyErr_Occurred()) return NULL;
        gap[k == 0 ? TICK : NUMBER] = whole(number, digits[k]);
    }
    const char *places = places_in(turn, count > 3 ? args[3] : NULL);
    if (places == NULL) return NULL;
    const Kind *kind = turn->kinds, *end = kind + turn->count;
    while (kind < end && !told(&kind->sense, raw, gap)) kind++;
    if (kind == end || !below(INFINITY, gap[STATES].text, sides->rows * SIZE)) Py_RETURN_NONE;
    const int here = sides->side, there = 1 - here;
    Rows rows = {gap[STATES].text,      sides->value[here],    sides->density[here],
                 sides->value[there], sides->density[there], NULL};
    if (kind->brings && !hear_model(&turn->models, gap[MODELS].text, &rows)) Py_RETURN_NONE;
    PyObject *act = act_on(turn, &kind->act, gap, &rows, places);
    if (act != NULL) sides->side = there;
    else if (!PyErr_Occurred()) Py_RETURN_NONE;
    return act;
}

/* ---- Python ---- */

static PyMethodDef methods[] = {
    {"answer", (PyCFunction)(void (*)(void))turn_answer, METH_FASTCALL,
     "answer(raw, tick, number=0, places=b\"\")\n\n"
     "The bytes of the Act to a plain Sense of that tick, and of that round where it is of one, what is learned being\n"
     "on the other side. Where an Act says models: the places (models,), intp, of the rows whose they are. None, and\n"
     "nothing has changed: it is no Sense of one of the kinds, not finite, of other rows, or a number that comes out\n"
     "or a float of an upload is too large."},
    {NULL, NULL, 0, NULL},
};

static PyType_Slot slots[] = {
    {Py_tp_doc, "Turn(sides, ((sense, act), ...)[, models, (first, last, item, largest)[, names]])\n\n"
                "Templates of what is asked and of the answers. models: how many travel, of each the floats first ...\n"
                "last - 1, of item bytes, those of an upload below largest. names: of the rows, (rows,), int32."},
    {Py_tp_new, turn_new},
    {Py_tp_dealloc, turn_dealloc},
    {Py_tp_methods, methods},
    {0, NULL},
};

static PyType_Spec spec = {"agent._kernel.Turn", sizeof(Turn), 0, Py_TPFLAGS_DEFAULT, slots};

int add_turn(PyObject *module) {
    PyObject *type = PyType_FromSpec(&spec);
    const int added = type == NULL ? -1 : PyModule_AddObjectRef(module, "Turn", type);
    Py_XDECREF(type);
    return added;
}
