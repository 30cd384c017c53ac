// Forward sensitivities of segments of flights, whitened rows and their normal equations, columns in SIMD lanes.
// Needs rates_linear, RATES_FIRST, RATES_INTO, rates_by_state, rates_by_control, the same of outputs, prepare.
// A row has WIDTH columns: LOOP of the loop's parameters, PATH of the control path's, STARTS initial states; the
// residual (RESIDUAL) lies in a lane that those leave free, or behind them.
#define LINEARISED

#include "step.h"

enum {
  FIRST_X0 = LOOP + PATH,
  VECTORS = WIDTH / W,
  MOVING = (FIRST_X0 + STARTS + W - 1) / W,  // vectors that are integrated
  PARAMETER_VECTORS = FIRST_X0 / W,
  ROWS = NY * (64 / NY > 0 ? 64 / NY : 1)    // rows gathered before they are multiplied out
};

struct Problem {
  int n;                 // samples of the longest segment
  double dt;
  const double* u;       // [S, n, NU]
  const double* path;    // [S, n, NU, PATH] derivatives of the controls by the control path's parameters
  const double* residual;  // [S, n, NY], NaN = missing
  const double* x0;      // [S, NX]
  const double* c;
  const double* weight;  // [NY] one over the standard deviation
  const int* pattern;    // [S, n] which whitening matrix, or null for `weight`
  const double* table;   // [patterns, NY, NY]
};

typedef double Row[WIDTH];

// upper += rows' rows, in the upper triangle: two vectors of columns by W rows at a time stay in registers.
static void multiply_out(const Row* rows, int count, Row* upper) {
  for (int b = 0; b < VECTORS; b += 2) {
    const int more = b + 1 < VECTORS;
    for (int i = 0; i < (b + 1 + more) * W; i += W / 2) {
      vd left[W / 2], right[W / 2];
      for (int q = 0; q < W / 2; q++) {
        left[q] = *(vd*)&upper[i + q][W * b];
        right[q] = more ? *(vd*)&upper[i + q][W * (b + 1)] : vd{};
      }
      if (more) for (int r = 0; r < count; r++) {
        const vd s = *(const vd*)&rows[r][W * b], t = *(const vd*)&rows[r][W * (b + 1)];
        for (int q = 0; q < W / 2; q++) { left[q] += rows[r][i + q] * s; right[q] += rows[r][i + q] * t; }
      } else for (int r = 0; r < count; r++) {
        const vd s = *(const vd*)&rows[r][W * b];
        for (int q = 0; q < W / 2; q++) left[q] += rows[r][i + q] * s;
      }
      for (int q = 0; q < W / 2; q++) {
        *(vd*)&upper[i + q][W * b] = left[q];
        if (more) *(vd*)&upper[i + q][W * (b + 1)] = right[q];
      }
    }
  }
}

struct Sensitivity {
  alignas(64) double S[NX][WIDTH] = {};
  alignas(64) double A[4][RATES_A], K[4][RATES_K] = {};
  alignas(64) double C[OUTPUTS_A], L[OUTPUTS_K] = {};
  alignas(64) Row raw[NY] = {}, rows[ROWS];
  vd path[4][NU + 1][PATH / W + 1];
  double x[NX], before[NX];
};

// Adds to the tangents what the parameters of vector b do themselves, and the control path through the controls. Each
// vector has straight-line code of its own: a loop of so few additions costs more than they do.
template <const int* FIRST, const int* INTO, int B, int... K>
static void add(const double* own, vd* out, std::integer_sequence<int, K...>) {
  ((out[INTO[FIRST[B] + K]] += *(const vd*)&own[(FIRST[B] + K) * W]), ...);
}
template <const int* FIRST, const int* INTO, int B> static void add(const double* own, vd* out) {
  add<FIRST, INTO, B>(own, out, std::make_integer_sequence<int, FIRST[B + 1] - FIRST[B]>());
}
template <const int* FIRST, const int* INTO, int... B>
static inline void direct(int b, const double* own, vd* out, std::integer_sequence<int, B...>) {
  static constexpr void (*ADD[])(const double*, vd*) = {add<FIRST, INTO, B>..., nullptr};
  if (b < PARAMETER_VECTORS) ADD[b](own, out);
}
template <const int* FIRST, const int* INTO> static inline void direct(int b, const double* own, vd* out) {
  direct<FIRST, INTO>(b, own, out, std::make_integer_sequence<int, PARAMETER_VECTORS>());
}
static inline bool on_path(int b) { return PATH && b >= LOOP / W && b < PARAMETER_VECTORS; }

// One Runge-Kutta step of vector b of the tangents.
static void tangent_step(int b, Sensitivity& s, const double* c, double dt) {
  vd X[NX], out[NX], U[NU + 1];
  for (int i = 0; i < NX; i++) X[i] = *(vd*)&s.S[i][W * b];
  auto slope = [&](const vd* D, int g, vd* k) {
    rates_by_state(s.A[g], c, D, k);
    direct<RATES_FIRST, RATES_INTO>(b, s.K[g], k);
    if (on_path(b)) {
      for (int j = 0; j < NU; j++) U[j] = s.path[g][j][b - LOOP / W];
      rates_by_control(s.A[g], c, U, k);
    }
  };
  runge_kutta(X, dt, slope, out);
  for (int i = 0; i < NX; i++) *(vd*)&s.S[i][W * b] = out[i];
}

static void output_rows(int b, Sensitivity& s, const double* c) {
  vd D[NX], U[NU + 1], y[NY];
  for (int i = 0; i < NX; i++) D[i] = *(vd*)&s.S[i][W * b];
  outputs_by_state(s.C, c, D, y);
  direct<OUTPUTS_FIRST, OUTPUTS_INTO>(b, s.L, y);
  if (on_path(b)) {
    for (int j = 0; j < NU; j++) U[j] = s.path[0][j][b - LOOP / W];
    outputs_by_control(s.C, c, U, y);
  }
  for (int i = 0; i < NY; i++) *(vd*)&s.raw[i][W * b] = y[i];
}

static void load_path(const Problem& p, size_t sample, bool last, Sensitivity& s) {
  if (!PATH) return;
  const double *a = p.path + sample * NU * PATH, *z = last ? a : a + NU * PATH;
  for (int g = 0; g < 4; g++) for (int j = 0; j < NU; j++) for (int q = 0; q < PATH; q++)
    ((double*)s.path[g][j])[q] = a[j * PATH + q] + SHARE(g) * (z[j * PATH + q] - a[j * PATH + q]);
}

// On to the next sample: state, and where derivatives are wanted its tangents.
template <bool DERIVATIVES>
static void onward(const double* u0, const double* u1, const double* c, double dt, Sensitivity& s) {
  double next[NX], u[NU + 1];
  auto slope = [&](const double* z, int g, double* k) {
    between(u0, u1, g, u);
    rates_linear(z, u, c, k, s.A[g], s.K[g]);
  };
  runge_kutta(s.x, dt, slope, next);
  memcpy(s.x, next, sizeof s.x);
  if (DERIVATIVES) for (int b = 0; b < MOVING; b++) tangent_step(b, s, c, dt);
}

// Columns of the results in their order: of rows, and of the upper part of a symmetric matrix [columns, columns].
struct Order {
  int columns;
  const int* of;
  double* rows(const Row* from, int count, double* to) const {
    for (int r = 0; r < count; r++, to += columns) for (int j = 0; j < columns; j++) to[j] = from[r][of[j]];
    return to;
  }
  void symmetric(const Row* upper, double* to) const {
    for (int a = 0; a < columns; a++) for (int b = a; b < columns; b++)
      to[(size_t)a * columns + b] = of[a] < of[b] ? upper[of[a]][of[b]] : upper[of[b]][of[a]];
  }
};

#ifndef TANGENTS_ALONE  // loops with tangents of their own need nothing of what follows
// Rows of one sample, whitened; what is missing is zero.
static void whiten(const Problem& p, size_t sample, Sensitivity& s, Row* rows) {
  const double* r = p.residual + sample * NY;
  for (int i = 0; i < NY; i++) {
    s.raw[i][RESIDUAL] = __builtin_isnan(r[i]) ? 0.0 : r[i];
  }
  for (int i = 0; i < NY; i++) {
    vd* to = (vd*)rows[i];
    if (!p.pattern) {
      const double w = __builtin_isnan(r[i]) ? 0.0 : p.weight[i];
      for (int b = 0; b < VECTORS; b++) to[b] = w == 0.0 ? vd{} : w * ((vd*)s.raw[i])[b];
      continue;
    }
    const double* w = p.table + ((size_t)p.pattern[sample] * NY + i) * NY;
    for (int b = 0; b < VECTORS; b++) to[b] = vd{};
    for (int j = 0; j <= i; j++) if (w[j] != 0.0)
      for (int b = 0; b < VECTORS; b++) to[b] += w[j] * ((vd*)s.raw[j])[b];
  }
}

// One segment: calls sink(rows, count) with whitened rows in order of time; ends with the tangents of its last sample.
template <class Sink>
static void segment(const Problem& p, int which, int length, Sensitivity& s, Sink sink) {
  double out[NY];
  memcpy(s.x, p.x0 + (size_t)which * NX, sizeof s.x);
  for (int i = 0; i < STARTS; i++) s.S[i][FIRST_X0 + i] = 1.0;
  int gathered = 0;
  for (int t = 0; t < length; t++) {
    const size_t sample = (size_t)which * p.n + t;
    const bool last = t == length - 1;
    const double *u0 = p.u + sample * NU, *u1 = last ? u0 : u0 + NU;
    load_path(p, sample, last, s);
    outputs_linear(s.x, u0, p.c, out, s.C, s.L);
    for (int b = 0; b < MOVING; b++) output_rows(b, s, p.c);
    whiten(p, sample, s, s.rows + gathered);
    gathered += NY;
    if (gathered == ROWS || last) { sink(s.rows, gathered); gathered = 0; }
    if (last) return;
    onward<true>(u0, u1, p.c, p.dt, s);
  }
}

// Part of a column's squared length that sums of products leave of it by rounding, where it depends on other columns.
static const double SAME = 1e-13;

// Rows of the triangle of the first `count` columns of a symmetric matrix H [n, n] (upper part), which becomes what is
// left of it. A column that depends on earlier ones to rounding gets a weak diagonal and nothing else: what it stands for stays put.
static void eliminate(int n, int count, double weak, double* H, double* triangle) {
  for (int i = 0; i < count; i++) {
    double* row = H + (size_t)i * n;
    double* to = triangle + (size_t)i * n;
    const double whole = to[i];  // the column's squared length, as the caller has put it there
    const bool told = row[i] > SAME * whole && row[i] > 0.0;
    const double pivot = told ? __builtin_sqrt(row[i]) : weak * (__builtin_sqrt(whole > 0.0 ? whole : 0.0) + 1e-3);
    for (int j = 0; j < n; j++) to[j] = j < i || !told ? 0.0 : row[j] / pivot;
    to[i] = pivot;
    if (!told) continue;
    for (int m = i + 1; m < n; m++) {
      const double f = to[m];
      if (f != 0.0) for (int j = m; j < n; j++) H[(size_t)m * n + j] -= f * to[j];
    }
  }
}

extern "C" void triangles(int count, int n, int first, double weak, double* H, double* out) {  // [count, n, n] -> [count, first, n]
  for (int s = 0; s < count; s++) {
    double *h = H + (size_t)s * n * n, *t = out + (size_t)s * first * n;
    for (int i = 0; i < first; i++) t[(size_t)i * n + i] = h[(size_t)i * n + i];
    Array<double> whole(n);
    for (int i = first; i < n; i++) whole[i] = h[(size_t)i * n + i];
    eliminate(n, first, weak, h, t);
    for (int i = first; i < n - 1; i++) {  // the residual stays
      if (h[(size_t)i * n + i] > SAME * whole[i]) continue;
      for (int j = first; j < n; j++) h[(size_t)F_minimum(i, j) * n + F_maximum(i, j)] = 0.0;
    }
  }
}

// order [n]: column of each entry of the result, the residual last; n columns.
// H [S, n, n] upper part of each segment's normal equations; passage [S, NX, NX]: last state by first.
extern "C" void normal_equations(int count, int n, double dt, const int* length, const double* u, const double* path,
                                 const double* residual, const double* x0, const double* th, const double* weight,
                                 const int* pattern, const double* table, int columns, const int* order, double* H,
                                 double* passage, int threads) {
  Array<double> c(NC);
  prepare(th, c.data());
  const Problem p{n, dt, u, path, residual, x0, c.data(), weight, pattern, table};
  each(count, threads, [&](int64_t i) {
    struct Room { Sensitivity s; alignas(64) Row upper[WIDTH] = {}; };
    Array<Room> room(1);
    segment(p, i, length[i], room->s, [&](const Row* rows, int k) { multiply_out(rows, k, room->upper); });
    Order{columns, order}.symmetric(room->upper, H + (size_t)i * columns * columns);
    for (int a = 0; a < STARTS; a++) for (int b = 0; b < STARTS; b++)
      passage[((size_t)i * NX + a) * NX + b] = room->s.S[a][FIRST_X0 + b];
  });
}

// The whitened rows themselves: rows [S, n * NY, columns], zero beyond a segment's end.
extern "C" void whitened_rows(int count, int n, double dt, const int* length, const double* u, const double* path,
                              const double* residual, const double* x0, const double* th, const double* weight,
                              const int* pattern, const double* table, int columns, const int* order, double* rows,
                              int threads) {
  Array<double> c(NC);
  prepare(th, c.data());
  const Problem p{n, dt, u, path, residual, x0, c.data(), weight, pattern, table};
  each(count, threads, [&](int64_t i) {
    Array<Sensitivity> s(1);
    double* to = rows + (size_t)i * n * NY * columns;
    segment(p, i, length[i], s[0], [&](const Row* made, int k) { to = Order{columns, order}.rows(made, k, to); });
  });
}
#endif
