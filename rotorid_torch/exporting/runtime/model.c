
/* ---- the way of a record: elements one after another, each sample by sample ---- */

enum { DELAY, LAG, RATE_LIMIT, PLAY, INSTANT };
static const double EDGE = 0.02, NOTHING = 1e-12;

static double clamped(double x, double low, double high) { return x < low ? low : x > high ? high : x; }

static void remember(rid_history* h, double t, const double* v, int n) {
  const int second = (h->newest + RID_DEPTH - 1) % RID_DEPTH;
  const int replace = h->count > 1 && (t <= h->t[h->newest] || t - h->t[second] < 0.999 * h->spacing);
  if (!replace) {
    h->newest = (h->newest + 1) % RID_DEPTH;
    if (h->count < RID_DEPTH) h->count++;
  }
  h->t[h->newest] = t;
  memcpy(h->v[h->newest], v, (size_t)n * sizeof *v);
}

/* Cubic interpolation (Catmull and Rom 1974) of one channel; straight on beyond the newest sample, held before the oldest. */
static double recalled(const rid_history* h, double t, int i) {
  int k, a, b, before, after;
  double span, part, slope_a, slope_b, rise;
  if (t >= h->t[h->newest]) return h->v[h->newest][i];
  for (k = 1, a = h->newest, b = a; k < h->count; k++) {
    b = a;
    a = (a + RID_DEPTH - 1) % RID_DEPTH;
    if (h->t[a] <= t) break;
  }
  if (h->t[a] > t) return h->v[a][i];
  before = k + 1 < h->count ? (a + RID_DEPTH - 1) % RID_DEPTH : a;
  after = b == h->newest ? b : (b + 1) % RID_DEPTH;
  span = h->t[b] - h->t[a];
  part = (t - h->t[a]) / span;
  rise = h->v[b][i] - h->v[a][i];
  slope_a = span * (h->v[b][i] - h->v[before][i]) / (h->t[b] - h->t[before]);
  slope_b = span * (h->v[after][i] - h->v[a][i]) / (h->t[after] - h->t[a]);
  return h->v[a][i] + part * (slope_a + part * (3.0 * rise - 2.0 * slope_a - slope_b + part * (slope_a + slope_b - 2.0 * rise)));
}

static void delayed(rid_element* e, double t, double* v, int n) {
  int i;
  remember(&e->history, t, v, n);
  for (i = 0; i < n; i++) v[i] = recalled(&e->history, t - (e->size[i] > 0.0 ? e->size[i] : 0.0), i);
}

static double lagged(double y, double before, double u, double tau, double h) {
  const double a = exp(-h / (tau > h / 700.0 ? tau : h / 700.0)), share = tau / h * (1.0 - a);
  return a * y + (share - a) * before + (1.0 - share) * u;
}

static double slewed(double y, double u, double inverse, double h) {
  const double d = u - y, fast = pow(inverse / h * d, 8.0);
  return u - d * (1.0 - pow(1.0 + fast, -0.125));
}

static double pushed(double y, double u, double width) {
  const double half = 0.5 * width, d = u - y, edge = EDGE * half > NOTHING ? EDGE * half : NOTHING;
  const double sign = d > 0.0 ? 1.0 : d < 0.0 ? -1.0 : 0.0;
  const double beyond = clamped(0.5 * (fabs(d) - (1.0 - EDGE) * half) / edge, 0.0, 1.0);
  return beyond < 1.0 ? y + sign * edge * beyond * beyond : u - sign * half;
}

static double in_play(const rid_element* e, int i) { return 0.5 * (1.0 - EDGE) * e->size[i] * e->place[i]; }

static void at_rest(rid_element* e, int kind, double t, double step, double* v, int n) {
  double longest = 0.0;
  int i;
  for (i = 0; i < n; i++) {
    e->before[i] = v[i];
    e->y[i] = kind == PLAY ? v[i] + in_play(e, i) : v[i];
    if (e->size[i] > longest) longest = e->size[i];
  }
  if (kind != DELAY) return;
  e->history.count = 0;
  e->history.newest = 0;
  e->history.spacing = longest / (RID_DEPTH - 8);
  remember(&e->history, t - step, v, n);
  remember(&e->history, t, v, n);
}

/* h > 0: a sample h later than the last one. h = 0: the record has jumped. */
static void onward(rid_element* e, int kind, double t, double h, double* v, int n) {
  int i;
  if (kind == DELAY) {
    delayed(e, t, v, n);
    return;
  }
  for (i = 0; i < n; i++) {
    const double u = v[i];
    if (h > 0.0) {
      if (kind == LAG) e->y[i] = lagged(e->y[i], e->before[i], u, e->size[i], h);
      if (kind == RATE_LIMIT) e->y[i] = slewed(e->y[i], u, e->size[i], h);
      if (kind == PLAY) e->y[i] = pushed(e->y[i], u, e->size[i]);
    }
    e->before[i] = u;
    if (e->size[i] <= 0.0) e->y[i] = u;
    v[i] = kind == PLAY ? e->y[i] - in_play(e, i) : e->y[i];
  }
}

typedef struct {
  const int *kinds, *instants;
  int count, n;
  rid_element* elements;
} chain;

/* A sample along the way: at rest since ever, h the step of its memory; or h later than the last one. */
static void along(const chain* way, const double* c, double t, double h, int rests, double* v) {
  double in[RID_WIDE];
  int k;
  for (k = 0; k < way->count; k++) {
    if (way->kinds[k] == INSTANT) {
      memcpy(in, v, (size_t)way->n * sizeof *v);
      INSTANTS[way->instants[k]](in, c, v);
    } else if (rests) {
      at_rest(&way->elements[k], way->kinds[k], t, h, v, way->n);
    } else {
      onward(&way->elements[k], way->kinds[k], t, h, v, way->n);
    }
  }
}

static chain path_of(rid_model* m) {
  const chain way = {PATH_KINDS, PATH_INSTANTS, RID_PATHS, RID_NU, m->path};
  return way;
}

static chain record_of(rid_model* m) {
  const chain way = {RECORD_KINDS, RECORD_INSTANTS, RID_RECORDS, RID_NY, m->record};
  return way;
}

/* ---- states of effects at rest: Newton's method from their start ---- */

static double size_of(double x) { return x == x ? fabs(x) : HUGE_VAL; }

/* a x = b by elimination with full pivoting; what has no pivot stays zero. */
static void solved(double a[RID_SETTLED + 1][RID_SETTLED + 1], double* b, double* x) {
  int order[RID_SETTLED + 1], n = RID_SETTLED, rank, i, j, k;
  double largest = 0.0;
  for (i = 0; i < n; i++) order[i] = i;
  for (rank = 0; rank < n; rank++) {
    int row = rank, column = rank;
    for (i = rank; i < n; i++)
      for (j = rank; j < n; j++)
        if (fabs(a[i][j]) > fabs(a[row][column])) row = i, column = j;
    if (rank == 0) largest = fabs(a[row][column]);
    if (fabs(a[row][column]) <= 1e-12 * largest) break;
    for (j = 0; j < n; j++) {
      const double other = a[rank][j];
      a[rank][j] = a[row][j], a[row][j] = other;
    }
    for (i = 0; i < n; i++) {
      const double other = a[i][rank];
      a[i][rank] = a[i][column], a[i][column] = other;
    }
    k = order[rank], order[rank] = order[column], order[column] = k;
    {
      const double other = b[rank];
      b[rank] = b[row], b[row] = other;
    }
    for (i = rank + 1; i < n; i++) {
      const double factor = a[i][rank] / a[rank][rank];
      for (j = rank; j < n; j++) a[i][j] -= factor * a[rank][j];
      b[i] -= factor * b[rank];
    }
  }
  for (i = 0; i < n; i++) x[i] = 0.0;
  for (i = rank - 1; i >= 0; i--) {
    double sum = b[i];
    for (j = i + 1; j < rank; j++) sum -= a[i][j] * x[order[j]];
    x[order[i]] = sum / a[i][i];
  }
}

static void settled(const rid_model* m, double* x) {
  const double probe = 1e-4;
  double a[RID_SETTLED + 1][RID_SETTLED + 1], b[RID_SETTLED + 1], change[RID_SETTLED + 1], at[RID_NX], near[RID_NX];
  int round, i, j;
  for (round = 0; RID_SETTLED > 0 && round < 4; round++) {
    rates(x, m->v, m->c, at);
    for (j = 0; j < RID_SETTLED; j++) {
      const double other = x[SETTLED[j]];
      x[SETTLED[j]] = other + probe;
      rates(x, m->v, m->c, near);
      x[SETTLED[j]] = other;
      for (i = 0; i < RID_SETTLED; i++) a[i][j] = (near[SETTLED[i]] - at[SETTLED[i]]) / probe;
    }
    for (i = 0; i < RID_SETTLED; i++) b[i] = at[SETTLED[i]];
    solved(a, b, change);
    for (i = 0; i < RID_SETTLED; i++)
      if (size_of(change[i]) < HUGE_VAL) x[SETTLED[i]] -= change[i];
  }
}

/* ---- what users call ---- */

void rid_prepare(rid_model* m) {
  prepare(m->theta, m->c);
  path_sizes(m->c, m->path);
  record_sizes(m->c, m->record);
}

void rid_defaults(rid_model* m) {
  memset(m, 0, sizeof *m);
  memcpy(m->theta, THETA, sizeof THETA);
  memcpy(m->start, START, sizeof START);
  memcpy(m->u, TRIM, sizeof TRIM);
  m->step = STEP;
  m->settle = 1;
  rid_prepare(m);
}

static void placed(rid_model* m) {
  const chain record = record_of(m);
  int i;
  memcpy(m->x, m->start, sizeof m->x);
  if (m->settle) {
    for (i = 0; i < RID_SETTLED; i++) m->x[SETTLED[i]] = START[SETTLED[i]];
    settled(m, m->x);
  }
  outputs(m->x, m->v, m->c, m->y);
  along(&record, m->c, m->t, m->step, 1, m->y);
}

void rid_begin(rid_model* m, double t) {
  const chain path = path_of(m);
  rid_prepare(m);
  m->t = t;
  memcpy(m->v, m->u, sizeof m->v);
  along(&path, m->c, t, m->step, 1, m->v);
  placed(m);
}

static void sensed(rid_model* m, double h) {
  const chain record = record_of(m);
  outputs(m->x, m->v, m->c, m->y);
  along(&record, m->c, m->t, h, 0, m->y);
}

void rid_refresh(rid_model* m) {
  const chain path = path_of(m);
  memcpy(m->v, m->u, sizeof m->v);
  along(&path, m->c, m->t, 0.0, 0, m->v);
  if (m->hold) placed(m); else sensed(m, 0.0);
}

/* A state beyond the limit stays there: a run that has diverged says so by its size. */
static double within(double x) { return x == x ? clamped(x, -LIMIT, LIMIT) : 0.0; }

static void slope(const rid_model* m, const double* x, const double* v0, const double* v1, double part, double* k) {
  double inside[RID_NX], v[RID_NU];
  int i;
  for (i = 0; i < RID_NX; i++) inside[i] = within(x[i]);
  for (i = 0; i < RID_NU; i++) v[i] = v0[i] + part * (v1[i] - v0[i]);
  rates(inside, v, m->c, k);
  for (i = 0; i < RID_NX; i++) k[i] = within(k[i]);
}

static void integrated(rid_model* m, const double* v0, const double* v1, double h) {
  double a[RID_NX], b[RID_NX], c[RID_NX], d[RID_NX], z[RID_NX];
  int i;
  slope(m, m->x, v0, v1, 0.0, a);
  for (i = 0; i < RID_NX; i++) z[i] = m->x[i] + h / 3.0 * a[i];
  slope(m, z, v0, v1, 1.0 / 3.0, b);
  for (i = 0; i < RID_NX; i++) z[i] = m->x[i] + h * (b[i] - a[i] * (1.0 / 3.0));
  slope(m, z, v0, v1, 2.0 / 3.0, c);
  for (i = 0; i < RID_NX; i++) z[i] = m->x[i] + h * (a[i] - b[i] + c[i]);
  slope(m, z, v0, v1, 1.0, d);
  for (i = 0; i < RID_NX; i++) m->x[i] += (a[i] + 3.0 * (b[i] + c[i]) + d[i]) * (h / 8.0);
}

void rid_step(rid_model* m, const double* u, double seconds) {
  const chain path = path_of(m);
  const double begun = m->t;
  double from[RID_NU], v0[RID_NU];
  const int pieces = seconds > m->step ? (int)ceil(seconds / m->step - 1e-6) : 1;
  int k, i;
  if (!(seconds > 0.0)) return;
  memcpy(from, m->u, sizeof from);
  for (k = 1; k <= pieces; k++) {
    const double h = seconds / pieces;
    memcpy(v0, m->v, sizeof v0);
    for (i = 0; i < RID_NU; i++) m->u[i] = k == pieces ? u[i] : from[i] + (u[i] - from[i]) * k / pieces;
    memcpy(m->v, m->u, sizeof m->v);
    m->t = begun + h * k;
    along(&path, m->c, m->t, h, 0, m->v);
    if (m->hold) {
      placed(m);
    } else {
      integrated(m, v0, m->v, h);
      sensed(m, h);
    }
  }
}

void rid_rates(const rid_model* m, const double* x, const double* v, double* out) { rates(x, v, m->c, out); }

void rid_outputs(const rid_model* m, const double* x, const double* v, double* out) { outputs(x, v, m->c, out); }
