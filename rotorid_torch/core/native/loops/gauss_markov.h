// Scalar Gauss-Markov filters and their adjoint smoothers, W rows in lanes, threads over groups of rows: the recursion
// of identification/reconstruct/gauss_markov.py. Records lie time by time, [T, N] with N a multiple of W.
#include "lanes.h"

struct Rows {
  int64_t samples, count;
  double dt;
  const double *value, *power, *integral, *noise, *tau, *trim, *spread;  // value and power [T, N], all others [N]
  double *likelihood, *realised, *expected, *level;                     // [N], [T, N], [T, N], [N]
};

static inline vd at(const double* p, size_t i) { vd v; memcpy(&v, p + i, sizeof v); return v; }
static inline void put(double* p, size_t i, vd v) { memcpy(p + i, &v, sizeof v); }

static void group(const Rows& r, size_t n, vd* kept) {
  const double dt = r.dt;
  const size_t N = r.count;
  const vd h0 = at(r.integral, n), h1 = 1.0 - h0, tau = at(r.tau, n), trim = at(r.trim, n), spread = at(r.spread, n);
  const vd e = F_exp(-dt / tau), a = h0 * tau * (1.0 - e), R = at(r.noise, n) * at(r.noise, n);
  const vd q00 = h0 * (dt * dt * dt / 3.0), q01 = h0 * (dt * dt / 2.0);
  const double q11 = dt;
  vd s{}, f{}, sg{}, fg{}, likelihood{}, top{}, bottom{};
  vl waiting = vl{} == 0;  // the integral starts where its first sample is
  for (int64_t k = 0; k < r.samples; k++) {
    const vd y = at(r.value, k * N + n) - trim * (h0 * (dt * k) + h1);
    const vl there = y == y;
    s = (waiting & there) ? h0 * y : s;
    waiting &= ~there;
  }
  vd p00 = h0 * 1e4 * R, p01{}, p11 = spread * spread + 1e-6 * R;
  for (int64_t k = 0; k < r.samples; k++) {
    const double t = dt * k;
    const vd measured = at(r.value, k * N + n) - trim * (h0 * t + h1);
    const vl there = measured == measured;
    const vd y = there ? measured : vd{}, present = there ? lanes(1.0) : vd{};
    const vd c0 = h0 * p00 + h1 * p01, c1 = h0 * p01 + h1 * p11, S = h0 * c0 + h1 * c1 + R, w = present / S;
    const vd v = y - h0 * s - h1 * f, g = h0 * (t - sg) + h1 * (1.0 - fg), k0 = c0 * w, k1 = c1 * w, vw = v * w;
    kept[4 * k] = w; kept[4 * k + 1] = k0; kept[4 * k + 2] = k1; kept[4 * k + 3] = vw;
    likelihood -= 0.5 * (v * vw + present * F_log(S));
    top += g * vw;
    bottom += g * g * w;
    s += k0 * v; f += k1 * v; sg += k0 * g; fg += k1 * g;
    p00 -= k0 * c0; p01 -= k0 * c1; p11 -= k1 * c1;
    s += a * f; f *= e; sg += a * fg; fg *= e;
    const vd q = at(r.power, (k + 1 < r.samples ? k + 1 : r.samples - 1) * N + n);
    p00 += a * (2.0 * p01 + a * p11) + q * q00;
    p01 = e * (p01 + a * p11) + q * q01;
    p11 = e * e * p11 + q * q11;
  }
  put(r.likelihood, n, likelihood);
  put(r.level, n, trim + top / (bottom + 1.0 / (spread * spread + 1e-6 * R)));
  vd r0{}, r1{}, n00{}, n01{}, n11{};
  for (int64_t k = r.samples - 1; k > 0; k--) {
    const vd w = kept[4 * k], k0 = kept[4 * k + 1], k1 = kept[4 * k + 2], vw = kept[4 * k + 3];
    const vd t = vw - k0 * r0 - k1 * r1;
    r0 += h0 * t; r1 += h1 * t;
    const vd u0 = n00 * k0 + n01 * k1, u1 = n01 * k0 + n11 * k1, kk = k0 * u0 + k1 * u1 + w;
    n00 += h0 * (kk - 2.0 * u0);
    n01 -= h0 * u1 + h1 * u0;
    n11 += h1 * (kk - 2.0 * u1);
    put(r.realised, k * N + n, r0 * (q00 * r0 + 2.0 * q01 * r1) + q11 * r1 * r1);
    put(r.expected, k * N + n, q00 * n00 + 2.0 * q01 * n01 + q11 * n11);
    r1 = a * r0 + e * r1;
    n11 = a * (a * n00 + 2.0 * e * n01) + e * e * n11;
    n01 = a * n00 + e * n01;
  }
}

extern "C" void gauss_markov(const Rows* rows, int threads) {
  each_group(rows->count / W * W, threads, [&](int64_t first, int) {
    Array<vd> kept(4 * rows->samples);
    group(*rows, (size_t)first, kept.data());
  });
}
