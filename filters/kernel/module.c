/* The Python module _kernel: the variants that this machine can run, and the layout of what they exchange. */
#define Py_LIMITED_API 0x030b0000
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stddef.h>
#include "layout.h"
#include "machine.h"

extern const Variant variant_portable, variant_avx2, variant_avx512;

static const struct {
    const char *name;
    const Variant *run;
} VARIANTS[] = {
#ifdef X86_VARIANTS
    {"avx512", &variant_avx512}, {"avx2", &variant_avx2},
#endif
    {"portable", &variant_portable}};
enum { COUNT = sizeof VARIANTS / sizeof *VARIANTS };

static int can_run(int variant) {
#ifdef X86_VARIANTS
    __builtin_cpu_init();
    if (variant == 0)
        return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
               __builtin_cpu_supports("avx512vl");
    if (variant == 1) return __builtin_cpu_supports("avx2") != 0;
#endif
    return variant < COUNT;
}

/* advance(variant, filter, past, count, steps, readings, log_relocation, outlier_m2, state, estimates, records) -> steps
   that were run, or what went wrong; without log_relocation (None) nothing stops it */
static PyObject *py_advance(PyObject *self, PyObject *args) {
    (void)self;
    int variant, past, count;
    Guard guard;
    Py_buffer part[7];
    if (!PyArg_ParseTuple(args, "iy*iiy*y*z*dw*w*w*", &variant, &part[0], &past, &count, &part[1], &part[2], &part[6],
                          &guard.outlier_m2, &part[3], &part[4], &part[5]))
        return NULL;
    guard.log_relocation = part[6].buf;
    const Filter *f = part[0].buf;
    const Step *steps = part[1].buf;
    Py_ssize_t readings = 0, n = 0, N = 0, depth = 0, blocks, tri;
    int good = part[0].len == sizeof(Filter) && part[1].len == (Py_ssize_t)sizeof(Step) * (past + count) &&
               variant >= 0 && variant < COUNT && can_run(variant) && past >= 0 && count >= 0;
    if (good) {
        n = f->n, N = f->N, depth = f->update != DRAWN ? 0 : f->move_steps > 1 ? f->move_steps : 1;
        good = n >= 6 && n <= MAX_STATES && N > 0 && depth <= MAX_DEPTH && past <= depth && f->bias_row < n - 1;
    }
    if (good) {
        Py_ssize_t used = 0;
        for (int s = 0; s < past + count; s++) readings += steps[s].readings, used += s < past ? 0 : steps[s].readings;
        blocks = (N + LANES - 1) / LANES, tri = n + n * (n + 1) / 2;
        good = part[2].len == (Py_ssize_t)sizeof(Reading) * readings &&
               part[3].len == 8 * LANES * blocks * (tri * (1 + depth) + (depth ? 2 + depth : 0)) &&
               part[4].len == 8 * (n + n * n + 2) * (count + 1) && part[5].len == 8 * (SHIFT + n) * used &&
               (!part[6].buf || part[6].len == 8 * (Py_ssize_t)count);
    }
    int status = GOOD;
    if (good)
        status = VARIANTS[variant].run->advance(f, steps, past, count, part[2].buf, part[6].buf ? &guard : NULL,
                                                part[3].buf, part[4].buf, part[5].buf);
    for (int i = 0; i < 7; i++) PyBuffer_Release(&part[i]);
    if (good) return PyLong_FromLong(status);
    PyErr_SetString(PyExc_ValueError, "the kernel was given arrays that do not fit together");
    return NULL;
}

static PyObject *finished(int good, int status) {
    if (good && status == NO_MEMORY) return PyErr_NoMemory();
    if (good) Py_RETURN_NONE;
    PyErr_SetString(PyExc_ValueError, "the kernel was given arrays that do not fit together");
    return NULL;
}

/* run_pass(variant, pass, the arrays in the order of PassArrays) */
static PyObject *py_run_pass(PyObject *self, PyObject *args) {
    (void)self;
    int variant, status = GOOD;
    Py_buffer part[1 + PASS_ARRAYS], *a = part + 1;
    if (!PyArg_ParseTuple(args, "iy*w*w*w*y*y*y*y*y*y*y*y*y*y*", &variant, &part[0], &a[0], &a[1], &a[2], &a[3], &a[4],
                          &a[5], &a[6], &a[7], &a[8], &a[9], &a[10], &a[11], &a[12]))
        return NULL;
    const Pass *p = part[0].buf;
    int good = part[0].len == sizeof(Pass) && variant >= 0 && variant < COUNT && can_run(variant) && p->n > 1 &&
               p->n <= MAX_STATES && p->N > 0 && p->F >= 0 && p->G > 0 && p->modes > 0 && p->modes <= MAX_MODES &&
               p->bias_row >= 0 && p->bias_row < p->n - 1;
    if (good) {
        Py_ssize_t n = p->n, N = p->N, F = p->F, G = p->G, modes = p->modes * N;
        const Py_ssize_t sizes[PASS_ARRAYS] = {n * N, n * n * N, N,     F * 2 * G, F * 2 * n * G, 3 * F * N, N,
                                               modes, modes,     modes, 4 * F,     F,             2 * F};
        for (int i = 0; i < PASS_ARRAYS; i++) good = good && a[i].len == 8 * sizes[i];
        for (Py_ssize_t m = 0; good && m < N; m++) good = ((int64_t *)a[6].buf)[m] >= 0 && ((int64_t *)a[6].buf)[m] < G;
    }
    if (good) {
        const PassArrays arrays = {a[0].buf, a[1].buf, a[2].buf, a[3].buf,  a[4].buf,  a[5].buf, a[6].buf,
                                   a[7].buf, a[8].buf, a[9].buf, a[10].buf, a[11].buf, a[12].buf};
        status = VARIANTS[variant].run->run_pass(p, &arrays);
    }
    for (int i = 0; i < 1 + PASS_ARRAYS; i++) PyBuffer_Release(&part[i]);
    return finished(good, status);
}

/* run_histories(variant, search, the arrays in the order of SearchArrays) */
static PyObject *py_run_histories(PyObject *self, PyObject *args) {
    (void)self;
    int variant, status = GOOD;
    Py_buffer part[1 + SEARCH_ARRAYS], *a = part + 1;
    if (!PyArg_ParseTuple(args, "iy*y*y*y*y*y*y*y*y*w*w*w*w*w*w*", &variant, &part[0], &a[0], &a[1], &a[2], &a[3], &a[4], &a[5],
                          &a[6], &a[7], &a[8], &a[9], &a[10], &a[11], &a[12], &a[13]))
        return NULL;
    const Search *s = part[0].buf;
    int good = part[0].len == sizeof(Search) && variant >= 0 && variant < COUNT && can_run(variant) && s->n > 6 &&
               s->n <= MAX_STATES && s->F >= 0 && s->modes > 0 && s->modes <= MAX_MODES && s->kinds > 0 &&
               s->kinds <= MAX_KINDS && s->bias_row >= 2 && s->bias_row < s->n - 5 && s->histories > 0 &&
               s->recent_bits > 0 && s->recent_bits < 20 && s->cell_m > 0.0;
    if (good) {
        int octaves = 0;
        while (s->F >> octaves) octaves++;
        good = s->kinds * (2 * s->histories + octaves) + 2 * octaves <= MAX_HISTORIES;
        Py_ssize_t n = s->n, F = s->F, result = F * MAX_HISTORIES;
        const Py_ssize_t sizes[SEARCH_ARRAYS] = {
            2 * F,        2 * F * n, 3 * F,  s->modes, 4 * s->modes * F, s->kinds * n, s->kinds * n * n,
            3 * s->kinds, result,    result, result,   result,           result,       F};
        for (int i = 0; i < SEARCH_ARRAYS; i++) good = good && a[i].len == 8 * sizes[i];
    }
    if (good) {
        const SearchArrays arrays = {a[0].buf, a[1].buf, a[2].buf, a[3].buf,  a[4].buf,  a[5].buf,  a[6].buf,
                                     a[7].buf, a[8].buf, a[9].buf, a[10].buf, a[11].buf, a[12].buf, a[13].buf};
        Py_BEGIN_ALLOW_THREADS
        status = VARIANTS[variant].run->run_histories(s, &arrays);
        Py_END_ALLOW_THREADS
    }
    for (int i = 0; i < 1 + SEARCH_ARRAYS; i++) PyBuffer_Release(&part[i]);
    return finished(good, status);
}

typedef struct {
    const char *name, *type;
    int offset, count;
} Field;
#define DESCRIBED(type, name, dimension) \
    {#name, #type, offsetof(This, name), sizeof((This *)0)->name / sizeof(type)},
#define ADD(layout, structure, FIELDS)                                                        \
    {                                                                                         \
        typedef structure This;                                                               \
        static const Field fields[] = {FIELDS(DESCRIBED)};                                    \
        add_structure(layout, #structure, sizeof(This), fields, sizeof fields / sizeof *fields); \
    }

/* layout[name] = size, [(name of a field, its type, offset, count), ...] */
static void add_structure(PyObject *layout, const char *name, size_t size, const Field *fields, size_t count) {
    PyObject *list = PyList_New(0);
    for (size_t i = 0; list && i < count; i++) {
        PyObject *field = Py_BuildValue("(ssii)", fields[i].name, fields[i].type, fields[i].offset, fields[i].count);
        if (field) PyList_Append(list, field);
        Py_XDECREF(field);
    }
    PyObject *both = list ? Py_BuildValue("(iN)", (int)size, list) : NULL;
    if (both && layout) PyDict_SetItemString(layout, name, both);
    Py_XDECREF(both);
}

enum { CALLS = 8 }; /* counts the changes of the arguments of the functions */
static PyMethodDef METHODS[] = {{"advance", py_advance, METH_VARARGS, "Run steps on a bank; see span.h."},
                                {"run_pass", py_run_pass, METH_VARARGS, "Run a bank over fixes; see fixes.h."},
                                {"run_histories", py_run_histories, METH_VARARGS, "Follow false fixes; see histories.h."},
                                {NULL, NULL, 0, NULL}};
static struct PyModuleDef MODULE = {PyModuleDef_HEAD_INIT, "_kernel", NULL, -1, METHODS, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__kernel(void) {
    PyObject *module = PyModule_Create(&MODULE), *names = PyList_New(0);
    for (int v = 0; module && names && v < COUNT; v++) {
        PyObject *pair = Py_BuildValue("(si)", VARIANTS[v].name, v);
        if (can_run(v) && pair) PyList_Append(names, pair);
        Py_XDECREF(pair);
    }
    if (module) {
        PyModule_AddObjectRef(module, "VARIANTS", names);
        PyObject *layout = PyDict_New();
        ADD(layout, Function, FUNCTION_FIELDS) /* what is part of another comes before it */
        ADD(layout, NoiseModes, NOISE_MODES_FIELDS)
        ADD(layout, Reading, READING_FIELDS)
        ADD(layout, Step, STEP_FIELDS)
        ADD(layout, Filter, FILTER_FIELDS)
        ADD(layout, Pass, PASS_FIELDS)
        ADD(layout, Search, SEARCH_FIELDS)
        PyModule_AddObjectRef(module, "LAYOUT", layout);
        Py_XDECREF(layout);
        PyModule_AddIntConstant(module, "CALLS", CALLS);
        PyObject *limits = Py_BuildValue("(iiiiii)", (int)LANES, (int)MAX_STATES, (int)MAX_MODES, (int)MAX_COLUMNS,
                                         (int)MAX_DEPTH, (int)MAX_HISTORIES);
        PyModule_AddObjectRef(module, "LIMITS", limits);
        Py_XDECREF(limits);
    }
    Py_XDECREF(names);
    return module;
}
