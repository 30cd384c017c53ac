// The discrete adjoint of trajectories: what a cost says of states and outputs, carried back through every step to
// initial states, controls and parameters. W trajectories in lanes, threads over groups of W; sums over groups are
// taken in their order. The stages of a step are made again from its first state.
// Needs rates<T>, rates_pull, outputs_pull, RATES_BY, OUTPUTS_BY, prepare.
#include "step.h"

enum { BY = RATES_N > OUTPUTS_N ? RATES_N : OUTPUTS_N };

struct Adjoint {
  vd total[COUNT + 1] = {};  // by parameters
  vd by[BY + 1];
};

// Rates at a state, pulled back along k: adds to the state's adjoint in `to`, the controls' in `gu`, the parameters'.
static inline void pull_rates(const vd* x, const vd* u, const double* c, const vd* k, vd* to, vd* gu, Adjoint& a) {
  rates_pull(x, u, c, k, to, gu, a.by);
  for (int i = 0; i < RATES_N; i++) a.total[RATES_BY[i]] += a.by[i];
}

// One step from x under controls u0 to u1: l, the adjoint of its end, becomes that of its start; adds to g0 and g1.
static void pull_step(const vd* x, const vd* u0, const vd* u1, double dt, const double* c, vd* l, vd* g0, vd* g1,
                      Adjoint& a) {
  vd z[4][NX], k[4][NX], bar[4][NX], by_state[NX], u[NU + 1], gu[NU + 1];
  const double part[4] = {1.0 / 8.0, 3.0 / 8.0, 3.0 / 8.0, 1.0 / 8.0};
  runge_kutta(x, dt, [&](const vd* at, int g, vd* to) {
    memcpy(z[g], at, sizeof z[g]);
    if (g == 3) { memset((void*)to, 0, sizeof k[3]); return; }  // the end is not asked for
    between(u0, u1, g, u);
    rates(at, u, c, to);
  }, k[0]);
  for (int g = 0; g < 4; g++) for (int i = 0; i < NX; i++) bar[g][i] = dt * part[g] * l[i];
  for (int g = 3; g >= 0; g--) {
    between(u0, u1, g, u);
    pull_rates(z[g], u, c, bar[g], by_state, gu, a);
    for (int j = 0; j < NU; j++) { g0[j] += (1.0 - NODE[g]) * gu[j]; g1[j] += NODE[g] * gu[j]; }
    for (int i = 0; i < NX; i++) {
      const vd s = by_state[i];
      l[i] += s;
      if (g == 3) { bar[0][i] += dt * s; bar[1][i] -= dt * s; bar[2][i] += dt * s; }
      if (g == 2) { bar[1][i] += dt * s; bar[0][i] -= dt / 3.0 * s; }
      if (g == 1) bar[0][i] += dt / 3.0 * s;
    }
  }
}

static inline void load(const double* from, size_t stride, int used, int count, vd* to) {
  for (int l = 0; l < W; l++) for (int i = 0; i < count; i++) to[i][l] = from[(l < used ? l : 0) * stride + i];
}
static inline void store(const vd* from, size_t stride, int used, int count, double* to) {
  for (int l = 0; l < used; l++) for (int i = 0; i < count; i++) to[l * stride + i] = from[i][l];
}

static void group(int used, int n, double dt, const double* u, const double* states, const double* c, const double* gx,
                  const double* gy, double* gx0, double* gu, Adjoint& a) {
  const size_t nu = (size_t)n * NU, nx = (size_t)n * NX, ny = (size_t)n * NY;
  vd l[NX] = {}, x[NX], u0[NU + 1] = {}, u1[NU + 1] = {}, g0[NU + 1] = {}, g1[NU + 1] = {}, told[NX], y[NY], by_state[NX],
     by_control[NU + 1];
  for (int t = n - 1; t >= 0; t--) {
    load(states + (size_t)t * NX, nx, used, NX, x);
    load(u + (size_t)t * NU, nu, used, NU, u0);
    for (int j = 0; j < NU; j++) g0[j] = vd{};
    if (t < n - 1) {
      pull_step(x, u0, u1, dt, c, l, g0, g1, a);
      store(g1, nu, used, NU, gu + (size_t)(t + 1) * NU);
    }
    load(gx + (size_t)t * NX, nx, used, NX, told);
    load(gy + (size_t)t * NY, ny, used, NY, y);
    outputs_pull(x, u0, c, y, by_state, by_control, a.by);
    for (int i = 0; i < OUTPUTS_N; i++) a.total[OUTPUTS_BY[i]] += a.by[i];
    for (int i = 0; i < NX; i++) l[i] += told[i] + by_state[i];
    for (int j = 0; j < NU; j++) { g1[j] = g0[j] + by_control[j]; u1[j] = u0[j]; }
  }
  store(g1, nu, used, NU, gu);
  store(l, NX, used, NX, gx0);
}

// u [B, n, NU], states [B, n, NX], a cost's derivatives gx by the states and gy [B, n, NY] by the outputs
// -> gx0 [B, NX], gu [B, n, NU], gth [COUNT].
extern "C" void pull(int count, int n, double dt, const double* u, const double* states, const double* th,
                     const double* gx, const double* gy, double* gx0, double* gu, double* gth, int threads) {
  Array<double> c(NC);
  prepare(th, c.data());
  const int groups = (count + W - 1) / W;
  Array<double> sums((size_t)groups * COUNT);
  each_group(count, threads, [&](int64_t b, int used) {
    Array<Adjoint> a(1);
    group(used, n, dt, u + b * n * NU, states + b * n * NX, c.data(), gx + b * n * NX, gy + b * n * NY, gx0 + b * NX,
          gu + b * n * NU, a[0]);
    for (int p = 0; p < COUNT; p++) for (int l = 0; l < used; l++) sums[(size_t)(b / W) * COUNT + p] += a->total[p][l];
  });
  for (int p = 0; p < COUNT; p++) { gth[p] = 0.0; for (int g = 0; g < groups; g++) gth[p] += sums[(size_t)g * COUNT + p]; }
}
