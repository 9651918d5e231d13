/* The frame of ttus_opt (docs/method/rendering.md), for every shell point in turn. */
#include "ttus_reader.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { POINTS, N_R, N_THETA, N_Z, NODES_THETA, NODES_Z, TRILINEAR, COUNTS };

/* Names of the file's limits: lengths in metres, angles in radians. */
enum {
  R_INNER, PER_R, R_OUTER, PER_THETA, Z_MIN, PER_Z, Z_MAX,
  THETA_0, WIDTH, SHIFT, LAST_CELL, LENGTH, LIMITS
};
enum { NODE_THETA_0, NODE_PER_THETA, NODE_Z_0, NODE_PER_Z, LAYOUT };

static const double TURN = 6.283185307179586476925;
static const double REFERENCE_LENGTH = 0.01; /* of a patch, for sampling by size [m] */

struct ttus_field {
  int64_t n[COUNTS];
  double limits[LIMITS], layout[LAYOUT], caps[2];
  double highest;                                 /* largest radius of the skin [m] */
  double *points, *lever, *radius, *spokes, *values; /* in one block of memory */
  double *share;                                  /* scratch: one number a point */
  int64_t *touched, *voxel;                       /* scratch */
  int32_t *hits;                                  /* scratch: points per voxel */
};

static double clamp(double x, double low, double high) {
  return x < low ? low : x > high ? high : x;
}

static uint32_t crc32_of(uint32_t crc, const void *bytes, size_t size) {
  const unsigned char *b = bytes;
  crc = ~crc;
  for (size_t i = 0; i < size; ++i) {
    crc ^= b[i];
    for (int bit = 0; bit < 8; ++bit) crc = crc >> 1 ^ (0xEDB88320u & -(crc & 1u));
  }
  return ~crc;
}

static int get(FILE *file, void *into, size_t size, uint32_t *crc) {
  if (fread(into, 1, size, file) != size) return 0;
  *crc = crc32_of(*crc, into, size);
  return 1;
}

void ttus_free(ttus_field *f) {
  if (!f) return;
  free(f->points), free(f->share), free(f->touched), free(f->voxel), free(f->hits);
  free(f);
}

/* Reads into an empty field; NULL, or what is wrong. */
static const char *read_into(ttus_field *f, FILE *file) {
  char magic[8];
  uint32_t crc = 0, stored;
  if (!get(file, magic, 8, &crc) || memcmp(magic, "TTUSFLT1", 8))
    return "not a flat field of this version: write it with ttus-opt render --flat";
  if (!get(file, f->n, sizeof f->n, &crc)) return "the file is cut off";
  for (int i = 0; i < TRILINEAR; ++i)
    if (f->n[i] < 2 - (i == POINTS) || f->n[i] > 1000000) return "damaged: its counts";
  const size_t m = f->n[POINTS], spokes = (size_t)f->n[N_THETA] * f->n[N_Z];
  const size_t nodes = (size_t)f->n[NODES_THETA] * f->n[NODES_Z];
  const double voxels = (double)f->n[N_R] * (double)spokes;
  if (voxels > 1e9 || nodes > 100000000) return "damaged: its counts";
  const size_t total = 9 * m + nodes + 3 * spokes + (size_t)voxels;
  f->points = malloc(total * sizeof(double));
  f->share = malloc(m * sizeof(double));
  f->touched = malloc(m * sizeof(int64_t));
  f->voxel = malloc(m * sizeof(int64_t));
  f->hits = calloc((size_t)voxels, sizeof(int32_t));
  if (!f->points || !f->share || !f->touched || !f->voxel || !f->hits)
    return "not enough memory";
  f->lever = f->points + 3 * m;
  f->radius = f->lever + 6 * m;
  f->spokes = f->radius + nodes;
  f->values = f->spokes + 3 * spokes;
  if (!get(file, f->limits, sizeof f->limits, &crc) ||
      !get(file, f->layout, sizeof f->layout, &crc) ||
      !get(file, f->caps, sizeof f->caps, &crc) ||
      !get(file, f->points, total * sizeof(double), &crc) ||
      fread(&stored, 1, 4, file) != 4)
    return "the file is cut off";
  if (stored != crc || fgetc(file) != EOF) return "damaged: its checksum is wrong";
  for (size_t i = 0; i < nodes; ++i) f->highest = fmax(f->highest, f->radius[i]);
  return NULL;
}

ttus_field *ttus_load(const char *path, const char **error) {
  const char *wrong = "not enough memory";
  ttus_field *f = calloc(1, sizeof *f);
  FILE *file = f ? fopen(path, "rb") : NULL;
  if (f) wrong = file ? read_into(f, file) : "cannot open the file";
  if (file) fclose(file);
  if (error) *error = wrong;
  if (!wrong) return f;
  ttus_free(f);
  return NULL;
}

/* Corrects rounding in place, Newton-Schulz; 0 if it is no rotation. */
static int orthonormalise(double R[9]) {
  for (int step = 0; step < 3; ++step) {
    double e[9], worst = 0.0, old[9];
    for (int i = 0; i < 9; ++i) {
      const int a = i / 3, b = i % 3;
      e[i] = R[a] * R[b] + R[3 + a] * R[3 + b] + R[6 + a] * R[6 + b] - (a == b);
      if (!isfinite(e[i])) return 0;
      worst = fmax(worst, fabs(e[i]));
    }
    if (worst <= 1e-12) break;
    if (worst > 1e-5) return 0;
    memcpy(old, R, sizeof old);
    for (int i = 0; i < 9; ++i)
      for (int k = 0; k < 3; ++k) R[i] -= 0.5 * old[i / 3 * 3 + k] * e[3 * k + i % 3];
  }
  return R[0] * (R[4] * R[8] - R[5] * R[7]) + R[1] * (R[5] * R[6] - R[3] * R[8]) +
             R[2] * (R[3] * R[7] - R[4] * R[6]) > 0.0;
}

static void rotated(const double R[9], const double v[3], double out[3]) {
  for (int i = 0; i < 3; ++i)
    out[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2];
}

/* The skin's radius, bilinear between the surface's nodes [m]. */
static double skin_at(const ttus_field *f, double theta, double z) {
  const int64_t n = f->n[NODES_THETA], n_z = f->n[NODES_Z];
  const double u = (theta - f->layout[NODE_THETA_0]) * f->layout[NODE_PER_THETA];
  const double w =
      clamp((z - f->layout[NODE_Z_0]) * f->layout[NODE_PER_Z], 0.0, n_z - 1.0);
  const int64_t j = (((int64_t)floor(u)) % n + n) % n, next = j + 1 == n ? 0 : j + 1;
  const int64_t k = (int64_t)w < n_z - 2 ? (int64_t)w : n_z - 2;
  const double a = u - floor(u), b = w - k;
  const double *here = f->radius + j * n_z + k, *after = f->radius + next * n_z + k;
  return (1.0 - a) * ((1.0 - b) * here[0] + b * here[1]) +
         a * ((1.0 - b) * after[0] + b * after[1]);
}

/* Position of an angle among the spokes of the grid. */
static double spoke_place(const double *l, double around) {
  return clamp(around * l[PER_THETA] - l[SHIFT], 0.0, l[LAST_CELL] + 1.0);
}

/* The field at a depth, between the four spokes around a place. */
static double trilinear(const ttus_field *f, double around, double z, double depth) {
  const double *l = f->limits;
  const int64_t n_theta = f->n[N_THETA], n_z = f->n[N_Z], layer = n_theta * n_z;
  const double v = spoke_place(l, around), w = (z - l[Z_MIN]) * l[PER_Z];
  const int64_t j = (int64_t)fmin(floor(v), l[LAST_CELL]);
  const int64_t k = (int64_t)w < n_z - 2 ? (int64_t)w : n_z - 2;
  double p = 0.0;
  for (int corner = 0; corner < 4; ++corner) {
    const int over = corner >> 1, up = corner & 1;
    const int64_t spoke = (over ? (j + 1 == n_theta ? 0 : j + 1) : j) * n_z + k + up;
    const double place = f->spokes[3 * spoke], outermost = f->spokes[3 * spoke + 1];
    const double reached = fmin(depth * l[PER_R], place), u = place - reached;
    const double i = fmin(floor(u), outermost);
    const double *at = f->values + (int64_t)i * layer + spoke;
    const double part = (over ? v - j : 1.0 - (v - j)) * (up ? w - k : 1.0 - (w - k));
    if (u >= outermost) /* linear to zero at the skin */
      p += part * reached * f->spokes[3 * spoke + 2] * at[0];
    else
      p += part * ((1.0 - (u - i)) * at[0] + (u - i) * at[layer]);
  }
  return p;
}

/* The voxel of a point; -1 if the point samples nothing (voxel-mean). */
static int64_t nearest(const ttus_field *f, double r, double around, double z,
                       double depth) {
  const double *l = f->limits;
  const int64_t n_theta = f->n[N_THETA], n_z = f->n[N_Z];
  const int64_t layer = (int64_t)((r - l[R_INNER]) * l[PER_R] + 0.5);
  const int64_t i = layer > 0 ? layer : 0;
  const int64_t j = (int64_t)(spoke_place(l, around) + 0.5) % n_theta;
  const int64_t spoke = j * n_z + (int64_t)((z - l[Z_MIN]) * l[PER_Z] + 0.5);
  const double *s = f->spokes + 3 * spoke;
  const int samples = i <= s[1] && s[0] - depth * l[PER_R] < s[1] + 0.5;
  return samples ? i * n_theta * n_z + spoke : -1;
}

/* Sums of a patch: area times depth, and its moments, in the probe frame. */
typedef struct { double weight, first[3], square; } moments;

static void add(moments *s, const double point[3], const double *lever, double depth) {
  const double w =
      depth * sqrt(lever[0] * lever[0] + lever[1] * lever[1] + lever[2] * lever[2]);
  s->weight += w;
  for (int a = 0; a < 3; ++a) {
    s->first[a] += w * point[a];
    s->square += w * point[a] * point[a];
  }
}

static double size_factor(const moments *s, double length) {
  double spread = 0.0;
  if (s->weight > 0.0) {
    spread = s->square / s->weight;
    for (int a = 0; a < 3; ++a) spread -= pow(s->first[a] / s->weight, 2);
  }
  return REFERENCE_LENGTH / sqrt(length * length + 12.0 * fmax(spread, 0.0));
}

/* Scales a wrench down to the limits; one that is not finite becomes zero. */
static void cut(double wrench[6], const double caps[2]) {
  const double *w = wrench;
  const double force = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]) / caps[0];
  const double torque = sqrt(w[3] * w[3] + w[4] * w[4] + w[5] * w[5]) / caps[1];
  const double excess = fmax(force, torque);
  if (force <= 1.0 && torque <= 1.0) return;
  for (int c = 0; c < 6; ++c) wrench[c] = isfinite(force + torque) ? w[c] / excess : 0.0;
}

int32_t ttus_render(ttus_field *f, const double rotation[9], const double position[3],
                    double wrench[6]) {
  const double *l = f->limits;
  const int64_t m = f->n[POINTS];
  double R[9], sum[6] = {0};
  int64_t contact = 0;
  int in_grid = 0;
  moments patch = {0};
  memcpy(R, rotation, sizeof R);
  if (!isfinite(position[0] + position[1] + position[2]) || !orthonormalise(R))
    return TTUS_READER_BAD_POSE;
  for (int64_t i = 0; i < m; ++i) {
    const double point[3] = {f->points[i], f->points[m + i], f->points[2 * m + i]};
    double at[3];
    rotated(R, point, at);
    for (int a = 0; a < 3; ++a) at[a] += position[a];
    const double squared = at[0] * at[0] + at[1] * at[1], z = at[2];
    if (squared > l[R_OUTER] * l[R_OUTER] || z < l[Z_MIN] || z > l[Z_MAX]) continue;
    if (in_grid && squared > f->highest * f->highest) continue; /* outside the skin */
    double theta = atan2(at[1], at[0]);
    if (theta < 0.0) theta += TURN;
    if (theta >= TURN) theta = 0.0; /* -1e-17 + TURN rounds up */
    double around = theta - l[THETA_0];
    if (around < 0.0) around += TURN;
    if (l[WIDTH] < TURN && around > l[WIDTH]) continue;
    in_grid = 1;
    const double r = sqrt(squared), fade = fmin(z - l[Z_MIN], l[Z_MAX] - z) * l[PER_Z];
    const double depth = (skin_at(f, theta, z) - r) * clamp(fade, 0.0, 1.0);
    if (!(depth > 0.0)) continue;
    f->touched[contact] = i;
    f->voxel[contact] = -1;
    if (f->n[TRILINEAR]) {
      f->share[contact] = trilinear(f, around, z, depth);
      if (l[LENGTH] > 0.0) add(&patch, point, f->lever + 6 * i, depth);
    } else {
      const int64_t v = nearest(f, r, around, z, depth);
      if (v >= 0) ++f->hits[v];
      f->voxel[contact] = v;
    }
    ++contact;
  }
  if (!f->n[TRILINEAR])
    for (int64_t c = 0; c < contact; ++c) { /* a voxel's value, shared by its points */
      const int64_t v = f->voxel[c];
      f->share[c] = v < 0 ? 0.0 : f->values[v] / f->hits[v];
    }
  for (int64_t c = 0; c < contact; ++c)
    for (int k = 0; k < 6; ++k) sum[k] += f->share[c] * f->lever[6 * f->touched[c] + k];
  for (int64_t c = 0; c < contact; ++c)
    if (f->voxel[c] >= 0) f->hits[f->voxel[c]] = 0; /* for the next frame */
  const double k = l[LENGTH] > 0.0 ? size_factor(&patch, l[LENGTH]) : 1.0;
  for (int c = 0; c < 6; ++c) sum[c] *= k;
  rotated(R, sum, wrench);
  rotated(R, sum + 3, wrench + 3);
  cut(wrench, f->caps);
  return in_grid ? (int32_t)contact : TTUS_READER_OFF_GRID;
}
