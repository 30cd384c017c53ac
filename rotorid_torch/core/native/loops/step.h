// One Runge-Kutta step of the model, controls linear within it: the 3/8 rule, torchdiffeq's "rk4" (Kutta 1901).
#pragma once
static const double NODE[4] = {0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0};
static const double SLOPE[4][3] = {{0, 0, 0}, {1.0 / 3.0, 0, 0}, {-1.0 / 3.0, 1.0, 0}, {1.0, -1.0, 1.0}};
static const double SHARE[4] = {0.125, 0.375, 0.375, 0.125};

template <class T> static inline void step(const T* x, const T* u0, const T* u1, double dt, const double* c, T* out) {
  T k[4][NX], z[NX], u[NU + 1];
#pragma GCC unroll 4
  for (int g = 0; g < 4; g++) {
    for (int i = 0; i < NX; i++) {
      T s = x[i];
      for (int m = 0; m < g; m++) s += (dt * SLOPE[g][m]) * k[m][i];
      z[i] = s;
    }
    for (int i = 0; i < NU; i++) u[i] = u0[i] + NODE[g] * (u1[i] - u0[i]);
    rates(z, u, c, k[g]);
  }
  for (int i = 0; i < NX; i++)
    out[i] = x[i] + (k[0][i] + 3.0 * (k[1][i] + k[2][i]) + k[3][i]) * (dt / 8.0);
}
