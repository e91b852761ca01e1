// The host path's signals and its progress callback: sums of light groups, alpha in the place of its colour's, what is
// refused, calls that a callback ends, frames in tiles.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <vkdenoise.h>

enum { WIDTH = 40, HEIGHT = 27, PIXELS = WIDTH * HEIGHT, SAMPLES = 3 * PIXELS };

static int failures;

#define EXPECT(condition)                                                                            \
  do {                                                                                               \
    if (!(condition)) {                                                                              \
      fprintf(stderr, "%s:%d: %s does not hold; last error: %s\n", __FILE__, __LINE__, #condition,   \
              vkdenoise_last_error());                                                               \
      failures++;                                                                                    \
    }                                                                                                \
  } while (0)

// The call is refused with this status and a message that has these words.
#define REFUSED(call, wanted, words)                                                                 \
  do {                                                                                               \
    vkdenoise_status status_ = (call);                                                               \
    EXPECT(status_ == (wanted));                                                                     \
    EXPECT(strstr(vkdenoise_last_error(), words));                                                   \
  } while (0)

// A colour with alpha, its two parts, a mask of one channel; and where they go.
static float rgba[PIXELS][4], key[SAMPLES], fill[SAMPLES], mask[PIXELS];
static float clean[PIXELS][4], clean_key[SAMPLES], clean_fill[SAMPLES], clean_mask[PIXELS];
static vkdenoise_plane color_plane;
static vkdenoise_plane_mut output_plane;
static vkdenoise_frame frame;

static vkdenoise_plane plane(const void *samples, size_t pixel_stride) {
  vkdenoise_plane made = VKDENOISE_INIT(vkdenoise_plane);
  made.samples = samples;
  made.pixel_stride = pixel_stride;
  return made;
}

static vkdenoise_plane_mut plane_mut(void *samples, size_t pixel_stride) {
  vkdenoise_plane_mut made = VKDENOISE_INIT(vkdenoise_plane_mut);
  made.samples = samples;
  made.pixel_stride = pixel_stride;
  return made;
}

static vkdenoise_signal signal_of(uint32_t kind, const vkdenoise_plane *from, const vkdenoise_plane_mut *to) {
  vkdenoise_signal made = VKDENOISE_INIT(vkdenoise_signal);
  made.kind = kind;
  made.plane = from;
  made.output = to;
  return made;
}

static void reset(void) {
  for (int i = 0; i < PIXELS; i++) {
    for (int c = 0; c < 3; c++) {
      float share = (float)((3 * i + c) * 31 % 64) / 64.0f;
      rgba[i][c] = 0.1f + (float)((3 * i + c) * 7919 % 97) / 60.0f;
      key[3 * i + c] = share * rgba[i][c];
      fill[3 * i + c] = rgba[i][c] - key[3 * i + c];
      clean_key[3 * i + c] = clean_fill[3 * i + c] = -1.0f;
    }
    rgba[i][3] = (float)(i * 7919 % 5) / 4.0f;
    mask[i] = (float)(i * 31 % 17) / 17.0f;
    for (int c = 0; c < 4; c++) clean[i][c] = -1.0f;
    clean_mask[i] = -1.0f;
  }
  color_plane = plane(rgba, 16);
  output_plane = plane_mut(clean, 16);
  frame = VKDENOISE_INIT(vkdenoise_frame);
  frame.width = WIDTH;
  frame.height = HEIGHT;
  frame.color = &color_plane;
  frame.output = &output_plane;
}

static int untouched(void) {
  for (int i = 0; i < PIXELS; i++) {
    for (int c = 0; c < 4; c++)
      if (clean[i][c] != -1.0f) return 0;
    for (int c = 0; c < 3; c++)
      if (clean_key[3 * i + c] != -1.0f || clean_fill[3 * i + c] != -1.0f) return 0;
    if (clean_mask[i] != -1.0f) return 0;
  }
  return 1;
}

// The mean difference between pixels that are neighbours.
static double roughness(const float *samples, int stride) {
  double sum = 0.0;
  for (int i = 1; i < PIXELS; i++) sum += fabs(samples[i * stride] - samples[(i - 1) * stride]);
  return sum / PIXELS;
}

static void sums_and_places(vkdenoise_denoiser *denoiser) {
  reset();
  vkdenoise_plane from[] = {plane(key, 0), plane(fill, 0), plane(mask, 0), plane(rgba[0] + 3, 16)};
  vkdenoise_plane_mut to[] = {plane_mut(clean_key, 0), plane_mut(clean_fill, 0), plane_mut(clean_mask, 0),
                              plane_mut(clean[0] + 3, 16)};
  const uint32_t light = VKDENOISE_SIGNAL_KIND_LIGHT, value = VKDENOISE_SIGNAL_KIND_VALUE;
  vkdenoise_signal signals[] = {signal_of(light, &from[0], &to[0]), signal_of(light, &from[1], &to[1]),
                                signal_of(value, &from[2], &to[2]),
                                signal_of(VKDENOISE_SIGNAL_KIND_ALPHA, &from[3], &to[3])};
  signals[2].channels = 1;
  frame.signals = signals;
  frame.signal_count = 4;
  vkdenoise_report report = VKDENOISE_INIT(vkdenoise_report);
  EXPECT(vkdenoise_denoise(denoiser, &frame, NULL, &report) == VKDENOISE_STATUS_OK);
  EXPECT(report.tiles == 1);
  float furthest = 0.0f;
  int covered = 1;
  for (int i = 0; i < PIXELS; i++) {
    for (int c = 0; c < 3; c++) {
      float sum = clean_key[3 * i + c] + clean_fill[3 * i + c];
      furthest = fmaxf(furthest, fabsf(sum - clean[i][c]) / clean[i][c]);
    }
    covered &= 0.0f <= clean[i][3] && clean[i][3] <= 1.0f;
  }
  EXPECT(furthest < 1e-5f && covered);
  EXPECT(roughness(clean_key, 3) < roughness(key, 3) / 2);
  EXPECT(roughness(clean_mask, 1) < roughness(mask, 1) / 2);
  EXPECT(roughness(clean[0] + 3, 4) < roughness(rgba[0] + 3, 4) / 2);

  // In place, and with the colour's result on a signal's samples; of a region.
  static float whole[PIXELS][4], parts[3][SAMPLES];
  memcpy(whole, clean, sizeof clean);
  memcpy(parts[0], clean_key, sizeof clean_key);
  memcpy(parts[1], clean_fill, sizeof clean_fill);
  memcpy(parts[2], clean_mask, sizeof clean_mask);
  reset();
  static float noisy_key[SAMPLES], noisy_mask[PIXELS];
  memcpy(noisy_key, key, sizeof key);
  memcpy(noisy_mask, mask, sizeof mask);
  to[0].samples = key;
  to[2].samples = mask;
  output_plane = plane_mut(fill, 0);
  frame.signals = signals;
  frame.signal_count = 4;
  vkdenoise_frame_options options = VKDENOISE_INIT(vkdenoise_frame_options);
  options.region = (vkdenoise_region){.x = 7, .y = 3, .width = 20, .height = 11};
  EXPECT(vkdenoise_denoise(denoiser, &frame, &options, NULL) == VKDENOISE_STATUS_OK);
  int same = 1;
  for (int i = 0; i < PIXELS; i++) {
    int x = i % WIDTH, y = i / WIDTH, inside = 7 <= x && x < 27 && 3 <= y && y < 14;
    same &= memcmp(key + 3 * i, (inside ? parts[0] : noisy_key) + 3 * i, 12) == 0;
    same &= mask[i] == (inside ? parts[2][i] : noisy_mask[i]);
    same &= clean_fill[3 * i] == (inside ? parts[1][3 * i] : -1.0f);
    same &= clean[i][3] == (inside ? whole[i][3] : -1.0f);
    if (inside) same &= memcmp(fill + 3 * i, whole[i], 12) == 0;
  }
  EXPECT(same);
}

static void refusals(vkdenoise_device *device, vkdenoise_denoiser *denoiser, const char *residual) {
  const vkdenoise_status invalid = VKDENOISE_STATUS_INVALID_ARGUMENT;
  reset();
  vkdenoise_plane from = plane(key, 0);
  vkdenoise_plane_mut to = plane_mut(clean_key, 0);
  vkdenoise_signal good = signal_of(VKDENOISE_SIGNAL_KIND_LIGHT, &from, &to), signals[2];
  frame.signals = signals;
  frame.signal_count = 2;
#define SIGNALS_REFUSED(status, words) REFUSED(vkdenoise_denoise(denoiser, &frame, NULL, NULL), status, words)
#define BOTH_GOOD signals[0] = signals[1] = good
  BOTH_GOOD;
  signals[1].kind = 3;
  SIGNALS_REFUSED(invalid, "kind is 3");
  BOTH_GOOD;
  signals[1].channels = 2;
  SIGNALS_REFUSED(invalid, "2 channels");
  signals[1].channels = 1;
  SIGNALS_REFUSED(invalid, "3 channels");
  BOTH_GOOD;
  signals[1].plane = NULL;
  SIGNALS_REFUSED(invalid, "signal plane is NULL");
  BOTH_GOOD;
  signals[1].output = NULL;
  SIGNALS_REFUSED(invalid, "vkdenoise_plane_mut is NULL");
  BOTH_GOOD;
  signals[1].struct_size += 8;
  SIGNALS_REFUSED(invalid, "differ in size");
  signals[0].struct_size = 0;
  SIGNALS_REFUSED(invalid, "struct_size of a vkdenoise_signal is 0");
  BOTH_GOOD;
  from.size = 12;
  SIGNALS_REFUSED(VKDENOISE_STATUS_PLANE_MISMATCH, "signal plane");
  from.size = 0;
  frame.signals = NULL;
  SIGNALS_REFUSED(invalid, "vkdenoise_signal is NULL");
  frame.signals = signals;

  // Descriptors of a later release, larger than this one's.
  struct {
    vkdenoise_signal known;
    uint64_t added;
  } later[2] = {{.known = good}, {.known = good}};
  later[0].known.struct_size = later[1].known.struct_size = sizeof later[0];
  frame.signals = &later[0].known;
  later[1].added = 1;
  SIGNALS_REFUSED(invalid, "too old");
  EXPECT(untouched());

  vkdenoise_options options = VKDENOISE_INIT(vkdenoise_options);
  vkdenoise_denoiser *other;
  options.signals = 1;
  options.weights_file = residual;
  REFUSED(vkdenoise_denoiser_create(device, &options, &other), invalid, "predicts no kernels");
  options.weights_file = NULL;
  options.signals = 2;
  REFUSED(vkdenoise_denoiser_create(device, &options, &other), invalid, "signals is 2");
  options.signals = 0;
  options.label_kernels = 2;
  REFUSED(vkdenoise_denoiser_create(device, &options, &other), invalid, "label_kernels");
  // A program of the first release, whose struct ends before.
  options.signals = 2;
  options.struct_size = offsetof(vkdenoise_options, signals);
  EXPECT(vkdenoise_denoiser_create(device, &options, &other) == VKDENOISE_STATUS_OK);
  BOTH_GOOD;
  frame.signals = signals;
  REFUSED(vkdenoise_denoise(other, &frame, NULL, NULL), invalid, "made without them");
  EXPECT(untouched());
  vkdenoise_denoiser_destroy(other);
}

// What a callback was told, and what it is to do.
struct watch {
  vkdenoise_denoiser *denoiser;
  int calls, end_at, grows;
  float last;
  vkdenoise_status inside;
};

static uint32_t watch(void *user, float share) {
  struct watch *watch = user;
  watch->grows &= watch->calls == 0 ? share == 0.0f : share >= watch->last;
  watch->last = share;
  vkdenoise_memory memory = VKDENOISE_INIT(vkdenoise_memory);
  watch->inside = vkdenoise_denoiser_memory_required(watch->denoiser, 8, 8, &memory);
  return ++watch->calls != watch->end_at;
}

static void progress(vkdenoise_denoiser *denoiser) {
  static float expected[PIXELS][4];
  vkdenoise_plane from;
  vkdenoise_plane_mut to;
  for (int end_at = 0; end_at <= 3; end_at++) {
    reset();
    from = plane(key, 0);
    to = plane_mut(clean_key, 0);
    vkdenoise_signal part = signal_of(VKDENOISE_SIGNAL_KIND_LIGHT, &from, &to);
    frame.signals = &part;
    frame.signal_count = 1;
    struct watch told = {.denoiser = denoiser, .end_at = end_at, .grows = 1};
    vkdenoise_frame_options options = VKDENOISE_INIT(vkdenoise_frame_options);
    options.progress = watch;
    options.progress_user = &told;
    if (end_at == 0) {
      EXPECT(vkdenoise_denoise(denoiser, &frame, NULL, NULL) == VKDENOISE_STATUS_OK);
      memcpy(expected, clean, sizeof clean);
      EXPECT(vkdenoise_denoise(denoiser, &frame, &options, NULL) == VKDENOISE_STATUS_OK);
      EXPECT(told.calls > 3 && told.grows && told.last == 1.0f);
      // The denoiser is taken: it would be waited for forever.
      EXPECT(told.inside == VKDENOISE_STATUS_INVALID_ARGUMENT);
    } else {
      REFUSED(vkdenoise_denoise(denoiser, &frame, &options, NULL), VKDENOISE_STATUS_CANCELLED, "cancelled");
      EXPECT(told.calls == end_at && told.grows);
      EXPECT(untouched());
      EXPECT(vkdenoise_denoise(denoiser, &frame, NULL, NULL) == VKDENOISE_STATUS_OK);
    }
    EXPECT(memcmp(clean, expected, sizeof clean) == 0);
  }
  EXPECT(strcmp(vkdenoise_status_string(VKDENOISE_STATUS_CANCELLED), "cancelled") == 0);
}

static void tiles(vkdenoise_device *device) {
  enum { LONG = 640, LOW = 100 };
  float *samples = calloc(3 * LONG * LOW, sizeof *samples);
  for (int i = 0; i < 3 * LONG * LOW; i++) samples[i] = 0.1f + (float)(i * 7919 % 97) / 60.0f;
  vkdenoise_plane from = plane(samples, 0);
  vkdenoise_plane_mut to = plane_mut(samples, 0);
  vkdenoise_frame strip = VKDENOISE_INIT(vkdenoise_frame);
  strip.width = LONG;
  strip.height = LOW;
  strip.color = &from;
  strip.output = &to;
  vkdenoise_options options = VKDENOISE_INIT(vkdenoise_options);
  options.memory_budget = 50 << 20;
  vkdenoise_denoiser *small;
  EXPECT(vkdenoise_denoiser_create(device, &options, &small) == VKDENOISE_STATUS_OK);
  vkdenoise_report report = VKDENOISE_INIT(vkdenoise_report);
  EXPECT(vkdenoise_denoise(small, &strip, NULL, &report) == VKDENOISE_STATUS_OK);
  EXPECT(report.tiles > 1 && report.device_bytes <= options.memory_budget);
  vkdenoise_denoiser_destroy(small);
  free(samples);
}

int main(int count, char **arguments) {
  if (count != 2) return fputs("give the weights of a network that predicts no kernels\n", stderr), 2;
  vkdenoise_device_options where = VKDENOISE_INIT(vkdenoise_device_options);
  where.device = getenv("VKDENOISE_DEVICE");
  vkdenoise_options options = VKDENOISE_INIT(vkdenoise_options);
  options.signals = 1;
  vkdenoise_device *device;
  vkdenoise_denoiser *denoiser;
  EXPECT(vkdenoise_device_open(&where, &device) == VKDENOISE_STATUS_OK);
  EXPECT(vkdenoise_denoiser_create(device, &options, &denoiser) == VKDENOISE_STATUS_OK);
  sums_and_places(denoiser);
  refusals(device, denoiser, arguments[1]);
  progress(denoiser);
  // What the report has of memory is all that is on the device.
  vkdenoise_denoiser_destroy(denoiser);
  tiles(device);
  vkdenoise_device_destroy(device);
  if (failures > 0) return fprintf(stderr, "%d expectations failed\n", failures), 1;
  puts("all as it should be");
  return 0;
}
