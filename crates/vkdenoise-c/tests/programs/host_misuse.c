// What the host path refuses, what it leaves untouched then, and what strides, halves and overlapping planes give.

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <vkdenoise.h>

enum { WIDTH = 24, HEIGHT = 18, SAMPLES = 3 * WIDTH * HEIGHT };

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

static float color[SAMPLES], output[SAMPLES];
static vkdenoise_plane color_plane;
static vkdenoise_plane_mut output_plane;
static vkdenoise_frame frame;

static void reset(void) {
  for (int i = 0; i < SAMPLES; i++) {
    color[i] = 0.1f + (float)(i * 7919 % 97) / 60.0f;
    output[i] = -1.0f;
  }
  color_plane = VKDENOISE_INIT(vkdenoise_plane);
  color_plane.samples = color;
  color_plane.size = sizeof color;
  output_plane = VKDENOISE_INIT(vkdenoise_plane_mut);
  output_plane.samples = output;
  output_plane.size = sizeof output;
  frame = VKDENOISE_INIT(vkdenoise_frame);
  frame.width = WIDTH;
  frame.height = HEIGHT;
  frame.color = &color_plane;
  frame.output = &output_plane;
}

static int untouched(void) {
  for (int i = 0; i < SAMPLES; i++)
    if (output[i] != -1.0f) return 0;
  return 1;
}

static void device_arguments(vkdenoise_device *device) {
  vkdenoise_device *none = device;
  REFUSED(vkdenoise_device_open(NULL, NULL), VKDENOISE_STATUS_INVALID_ARGUMENT, "NULL");
  vkdenoise_device_options options = {0};
  REFUSED(vkdenoise_device_open(&options, &none), VKDENOISE_STATUS_INVALID_ARGUMENT, "struct_size");
  EXPECT(none == NULL);
  options = VKDENOISE_INIT(vkdenoise_device_options);
  options.device = "no such device";
  REFUSED(vkdenoise_device_open(&options, &none), VKDENOISE_STATUS_NO_DEVICE, "no such device");
  options.device = "\xff";
  REFUSED(vkdenoise_device_open(&options, &none), VKDENOISE_STATUS_INVALID_ARGUMENT, "UTF-8");
  options.device = NULL;
  options.loader = "/no/such/loader.so";
  REFUSED(vkdenoise_device_open(&options, &none), VKDENOISE_STATUS_NO_LOADER, "loader");

  vkdenoise_renderer renderer = VKDENOISE_INIT(vkdenoise_renderer);
  REFUSED(vkdenoise_device_from_renderer(NULL, &none), VKDENOISE_STATUS_INVALID_ARGUMENT, "NULL");
  REFUSED(vkdenoise_device_from_renderer(&renderer, &none), VKDENOISE_STATUS_INVALID_ARGUMENT,
          "get_instance_proc_addr");
  renderer.enabled_features = 1u << 20;
  REFUSED(vkdenoise_device_from_renderer(&renderer, &none), VKDENOISE_STATUS_INVALID_ARGUMENT, "enabled_features");

  vkdenoise_device_info info = VKDENOISE_INIT(vkdenoise_device_info);
  REFUSED(vkdenoise_device_get_info(NULL, &info), VKDENOISE_STATUS_INVALID_ARGUMENT, "device is NULL");
  EXPECT(vkdenoise_device_get_info(device, &info) == VKDENOISE_STATUS_OK && info.name[0] && !info.missing[0]);
  vkdenoise_device_list *list;
  EXPECT(vkdenoise_device_list_create(&list) == VKDENOISE_STATUS_OK);
  uint32_t count = vkdenoise_device_list_count(list);
  EXPECT(count > 0);
  REFUSED(vkdenoise_device_list_get(list, count, &info), VKDENOISE_STATUS_INVALID_ARGUMENT, "there is no device");
  vkdenoise_device_list_destroy(list);
  EXPECT(vkdenoise_device_list_count(NULL) == 0 && vkdenoise_device_memory_bytes(NULL) == 0);

  EXPECT(strcmp(vkdenoise_requirement(VKDENOISE_REQUIREMENT_KIND_FEATURE, 0), "bufferDeviceAddress") == 0);
  EXPECT(vkdenoise_requirement(VKDENOISE_REQUIREMENT_KIND_FEATURE, 1) == NULL);
  EXPECT(vkdenoise_requirement(99, 0) == NULL);
  EXPECT(vkdenoise_abi_version() == VKDENOISE_ABI_VERSION);
  EXPECT(strcmp(vkdenoise_status_string(VKDENOISE_STATUS_OUT_OF_MEMORY), "out of memory") == 0);
  EXPECT(strcmp(vkdenoise_status_string(12345), "unknown status") == 0);
}

static void denoiser_arguments(vkdenoise_device *device, vkdenoise_denoiser *denoiser) {
  vkdenoise_denoiser *none = denoiser;
  vkdenoise_options options = VKDENOISE_INIT(vkdenoise_options);
  REFUSED(vkdenoise_denoiser_create(NULL, &options, &none), VKDENOISE_STATUS_INVALID_ARGUMENT, "device is NULL");
  EXPECT(none == NULL);
  options.quality = 7;
  REFUSED(vkdenoise_denoiser_create(device, &options, &none), VKDENOISE_STATUS_INVALID_ARGUMENT, "quality is 7");
  options.quality = 0;
  options.precision = 9;
  REFUSED(vkdenoise_denoiser_create(device, &options, &none), VKDENOISE_STATUS_INVALID_ARGUMENT, "precision is 9");
  options.precision = 0;
  options.keep_aux = 2;
  REFUSED(vkdenoise_denoiser_create(device, &options, &none), VKDENOISE_STATUS_INVALID_ARGUMENT, "keep_aux");
  options.keep_aux = 0;
  options.clean_aux = 2;
  REFUSED(vkdenoise_denoiser_create(device, &options, &none), VKDENOISE_STATUS_INVALID_ARGUMENT, "clean_aux");
  options.clean_aux = 0;
  options.weights_file = "/no/such/file.safetensors";
  REFUSED(vkdenoise_denoiser_create(device, &options, &none), VKDENOISE_STATUS_WEIGHTS, "/no/such/file");
  vkdenoise_memory memory = VKDENOISE_INIT(vkdenoise_memory);
  REFUSED(vkdenoise_denoiser_memory_required(denoiser, 0, 4, &memory), VKDENOISE_STATUS_INVALID_ARGUMENT, "empty");
  EXPECT(vkdenoise_denoiser_memory_required(denoiser, WIDTH, HEIGHT, &memory) == VKDENOISE_STATUS_OK);
  EXPECT(memory.arena > 0 && memory.weights > 0 && memory.staging > 0);
  EXPECT(vkdenoise_denoiser_precision(NULL) == VKDENOISE_PRECISION_AUTO);
  EXPECT(vkdenoise_denoiser_precision(denoiser) != VKDENOISE_PRECISION_AUTO);

  options = VKDENOISE_INIT(vkdenoise_options);
  options.memory_budget = 1000;
  EXPECT(vkdenoise_denoiser_create(device, &options, &none) == VKDENOISE_STATUS_OK);
  reset();
  REFUSED(vkdenoise_denoise(none, &frame, NULL, NULL), VKDENOISE_STATUS_FRAME_TOO_LARGE, "budget is 1000");
  EXPECT(untouched());
  vkdenoise_denoiser_destroy(none);
}

static void planes(vkdenoise_denoiser *denoiser) {
  reset();
#define FRAME_REFUSED(status, words) REFUSED(vkdenoise_denoise(denoiser, &frame, NULL, NULL), status, words)
  REFUSED(vkdenoise_denoise(NULL, &frame, NULL, NULL), VKDENOISE_STATUS_INVALID_ARGUMENT, "denoiser is NULL");
  REFUSED(vkdenoise_denoise(denoiser, NULL, NULL, NULL), VKDENOISE_STATUS_INVALID_ARGUMENT, "vkdenoise_frame is NULL");
  frame.struct_size = 8;
  FRAME_REFUSED(VKDENOISE_STATUS_INVALID_ARGUMENT, "struct_size of a vkdenoise_frame is 8");
  reset();
  frame.width = 0;
  FRAME_REFUSED(VKDENOISE_STATUS_INVALID_ARGUMENT, "empty");
  reset();
  frame.color = NULL;
  FRAME_REFUSED(VKDENOISE_STATUS_INVALID_ARGUMENT, "colour");
  reset();
  frame.output = NULL;
  FRAME_REFUSED(VKDENOISE_STATUS_INVALID_ARGUMENT, "vkdenoise_plane_mut is NULL");
  reset();
  color_plane.samples = NULL;
  FRAME_REFUSED(VKDENOISE_STATUS_INVALID_ARGUMENT, "colour plane are NULL");
  reset();
  color_plane.samples = (const char *)color + 2;
  FRAME_REFUSED(VKDENOISE_STATUS_PLANE_MISMATCH, "multiple");
  reset();
  color_plane.format = 2;
  FRAME_REFUSED(VKDENOISE_STATUS_INVALID_ARGUMENT, "format is 2");
  reset();
  color_plane.reserved = 1;
  FRAME_REFUSED(VKDENOISE_STATUS_INVALID_ARGUMENT, "reserved");
  reset();
  color_plane.size -= 1;
  FRAME_REFUSED(VKDENOISE_STATUS_PLANE_MISMATCH, "colour plane");
  reset();
  output_plane.row_stride = 4 * 3 * WIDTH + 4;
  FRAME_REFUSED(VKDENOISE_STATUS_PLANE_MISMATCH, "output plane");
  reset();
  color_plane.pixel_stride = 13;
  FRAME_REFUSED(VKDENOISE_STATUS_PLANE_MISMATCH, "pixel_stride is 13");
  reset();
  color_plane.size = 0;
  color_plane.row_stride = ~(size_t)0 / 8 * 8;
  FRAME_REFUSED(VKDENOISE_STATUS_PLANE_MISMATCH, "beyond");
  reset();
  frame.noise_kind = 5;
  FRAME_REFUSED(VKDENOISE_STATUS_INVALID_ARGUMENT, "noise_kind is 5");

  reset();
  vkdenoise_frame_options options = VKDENOISE_INIT(vkdenoise_frame_options);
#define OPTIONS_REFUSED(words) \
  REFUSED(vkdenoise_denoise(denoiser, &frame, &options, NULL), VKDENOISE_STATUS_INVALID_ARGUMENT, words)
  options.blend = 1.5f;
  OPTIONS_REFUSED("blend");
  options.blend = 0.0f;
  options.exposure = -1.0f;
  OPTIONS_REFUSED("exposure");
  options.exposure = 0.0f;
  options.fireflies = 3;
  OPTIONS_REFUSED("fireflies is 3");
  options.fireflies = 0;
  options.aux_unchanged = 1;
  OPTIONS_REFUSED("no frame of this size");
  options.aux_unchanged = 0;
  options.statistics_buffer = 1;
  OPTIONS_REFUSED("host path");
  options.statistics_buffer = 0;
  options.region.width = 5;
  OPTIONS_REFUSED("region");
  vkdenoise_report report = {0};
  REFUSED(vkdenoise_denoise(denoiser, &frame, NULL, &report), VKDENOISE_STATUS_INVALID_ARGUMENT, "vkdenoise_report");
  EXPECT(untouched());
}

// A struct of a later release: known where what is new is 0, refused where it is not. One of an earlier release: known.
static void versions(vkdenoise_denoiser *denoiser) {
  reset();
  struct {
    vkdenoise_frame_options known;
    uint64_t added[2];
  } later = {.known = {.struct_size = sizeof later}};
  EXPECT(vkdenoise_denoise(denoiser, &frame, &later.known, NULL) == VKDENOISE_STATUS_OK);
  later.added[1] = 1;
  REFUSED(vkdenoise_denoise(denoiser, &frame, &later.known, NULL), VKDENOISE_STATUS_INVALID_ARGUMENT, "too old");
  struct {
    vkdenoise_report known;
    uint64_t added[2];
  } report = {.known = {.struct_size = sizeof report}, .added = {5, 5}};
  EXPECT(vkdenoise_denoise(denoiser, &frame, NULL, &report.known) == VKDENOISE_STATUS_OK);
  EXPECT(report.known.struct_size == sizeof report && report.added[0] == 0 && report.added[1] == 0);
  EXPECT(report.known.exposure > 0.0f && report.known.work == 1.0 && report.known.total_ms > 0.0);
}

static uint16_t half_of(float value) {
  // Exact for the values that are used: below 2, with few bits.
  uint32_t bits;
  memcpy(&bits, &value, sizeof bits);
  return (uint16_t)(((bits >> 23) - 112) << 10 | (bits >> 13 & 0x3ff));
}

static void strides(vkdenoise_denoiser *denoiser) {
  static float expected[SAMPLES], planar[SAMPLES], padded[HEIGHT][WIDTH + 3][4];
  static uint16_t halves[SAMPLES];
  reset();
  for (int i = 0; i < SAMPLES; i++) color[i] = 0.5f + (float)(i * 7919 % 97) / 128.0f;
  EXPECT(vkdenoise_denoise(denoiser, &frame, NULL, NULL) == VKDENOISE_STATUS_OK);
  memcpy(expected, output, sizeof output);
  EXPECT(!untouched());

  // From RGBA with padded rows into planes.
  for (int y = 0; y < HEIGHT; y++)
    for (int x = 0; x < WIDTH; x++) memcpy(padded[y][x], color + 3 * (y * WIDTH + x), 12);
  color_plane.samples = padded;
  color_plane.size = sizeof padded;
  color_plane.pixel_stride = sizeof padded[0][0];
  color_plane.row_stride = sizeof padded[0];
  output_plane.samples = planar;
  output_plane.pixel_stride = 4;
  output_plane.channel_stride = 4 * WIDTH * HEIGHT;
  EXPECT(vkdenoise_denoise(denoiser, &frame, NULL, NULL) == VKDENOISE_STATUS_OK);
  int same = 1;
  for (int i = 0; i < SAMPLES; i++) same &= planar[i % 3 * WIDTH * HEIGHT + i / 3] == expected[i];
  EXPECT(same);

  // From halves.
  for (int i = 0; i < SAMPLES; i++) halves[i] = half_of(color[i]);
  color_plane = VKDENOISE_INIT(vkdenoise_plane);
  color_plane.samples = halves;
  color_plane.size = sizeof halves;
  color_plane.format = VKDENOISE_SAMPLE_FORMAT_F16;
  output_plane = VKDENOISE_INIT(vkdenoise_plane_mut);
  output_plane.samples = output;
  EXPECT(vkdenoise_denoise(denoiser, &frame, NULL, NULL) == VKDENOISE_STATUS_OK);
  EXPECT(memcmp(output, expected, sizeof output) == 0);

  // In place, and between the pixels of the input.
  color_plane = VKDENOISE_INIT(vkdenoise_plane);
  color_plane.samples = output_plane.samples = output;
  memcpy(output, color, sizeof output);
  EXPECT(vkdenoise_denoise(denoiser, &frame, NULL, NULL) == VKDENOISE_STATUS_OK);
  EXPECT(memcmp(output, expected, sizeof output) == 0);
  static float both[SAMPLES / 3][6];
  for (int i = 0; i < SAMPLES / 3; i++) memcpy(both[i], color + 3 * i, 12);
  color_plane.samples = both;
  output_plane.samples = both[0] + 3;
  color_plane.pixel_stride = output_plane.pixel_stride = sizeof both[0];
  vkdenoise_frame_options options = VKDENOISE_INIT(vkdenoise_frame_options);
  options.region = (vkdenoise_region){.x = 8, .y = 2, .width = 9, .height = 13};
  EXPECT(vkdenoise_denoise(denoiser, &frame, &options, NULL) == VKDENOISE_STATUS_OK);
  same = 1;
  for (int i = 0; i < SAMPLES / 3; i++) {
    int x = i % WIDTH, y = i / WIDTH, inside = 8 <= x && x < 17 && 2 <= y && y < 15;
    static const float zeros[3];
    same &= memcmp(both[i], color + 3 * i, 12) == 0;
    same &= memcmp(both[i] + 3, inside ? expected + 3 * i : zeros, 12) == 0;
  }
  EXPECT(same);

  // Into halves, in place too.
  static uint16_t narrow[SAMPLES];
  color_plane = VKDENOISE_INIT(vkdenoise_plane);
  color_plane.samples = color;
  output_plane = VKDENOISE_INIT(vkdenoise_plane_mut);
  output_plane.samples = narrow;
  output_plane.format = VKDENOISE_SAMPLE_FORMAT_F16;
  EXPECT(vkdenoise_denoise(denoiser, &frame, NULL, NULL) == VKDENOISE_STATUS_OK);
  color_plane.samples = output_plane.samples = halves;
  color_plane.format = VKDENOISE_SAMPLE_FORMAT_F16;
  EXPECT(vkdenoise_denoise(denoiser, &frame, NULL, NULL) == VKDENOISE_STATUS_OK);
  EXPECT(memcmp(narrow, halves, sizeof halves) == 0);
  EXPECT(narrow[0] != 0);
}

// What a thread is given: the frame is the shared one, the output its own.
struct job {
  vkdenoise_denoiser *denoiser;
  float exposure, output[SAMPLES];
  vkdenoise_status status;
};

static void *run_job(void *argument) {
  struct job *job = argument;
  vkdenoise_plane_mut to = VKDENOISE_INIT(vkdenoise_plane_mut);
  to.samples = job->output;
  vkdenoise_frame mine = frame;
  mine.output = &to;
  vkdenoise_frame_options options = VKDENOISE_INIT(vkdenoise_frame_options);
  options.exposure = job->exposure;
  for (int i = 0; i < 3 && !job->status; i++) job->status = vkdenoise_denoise(job->denoiser, &mine, &options, NULL);
  return NULL;
}

// Two threads call one denoiser, each with options of its own.
static void threads(vkdenoise_denoiser *denoiser) {
  static struct job alone[2], together[2];
  pthread_t running[2];
  reset();
  for (int i = 0; i < 2; i++) {
    alone[i].denoiser = together[i].denoiser = denoiser;
    alone[i].exposure = together[i].exposure = 0.5f + (float)i;
    run_job(&alone[i]);
    EXPECT(alone[i].status == VKDENOISE_STATUS_OK);
  }
  for (int i = 0; i < 2; i++) EXPECT(pthread_create(&running[i], NULL, run_job, &together[i]) == 0);
  for (int i = 0; i < 2; i++) {
    EXPECT(pthread_join(running[i], NULL) == 0);
    EXPECT(together[i].status == VKDENOISE_STATUS_OK);
    EXPECT(memcmp(together[i].output, alone[i].output, sizeof alone[i].output) == 0);
  }
  EXPECT(memcmp(alone[0].output, alone[1].output, sizeof alone[0].output) != 0);
}

// Objects go in any order.
static void lifetimes(void) {
  vkdenoise_device_options where = VKDENOISE_INIT(vkdenoise_device_options);
  where.device = getenv("VKDENOISE_DEVICE");
  where.cache = "off";
  vkdenoise_device *device;
  vkdenoise_denoiser *denoiser;
  vkdenoise_pass *pass;
  EXPECT(vkdenoise_device_open(&where, &device) == VKDENOISE_STATUS_OK);
  EXPECT(vkdenoise_denoiser_create(device, NULL, &denoiser) == VKDENOISE_STATUS_OK);
  EXPECT(vkdenoise_device_memory_bytes(device) > 0);
  EXPECT(vkdenoise_pass_create(denoiser, 8, 8, &pass) == VKDENOISE_STATUS_OK);
  vkdenoise_device_destroy(device);
  vkdenoise_denoiser_destroy(denoiser);
  vkdenoise_pass_destroy(pass);
  vkdenoise_device_destroy(NULL);
  vkdenoise_denoiser_destroy(NULL);
  vkdenoise_pass_destroy(NULL);
  vkdenoise_binding_destroy(NULL);
  vkdenoise_device_list_destroy(NULL);
}

int main(void) {
  EXPECT(vkdenoise_last_error()[0] == 0);
  vkdenoise_device_options where = VKDENOISE_INIT(vkdenoise_device_options);
  where.device = getenv("VKDENOISE_DEVICE");
  vkdenoise_device *device;
  vkdenoise_denoiser *denoiser;
  EXPECT(vkdenoise_device_open(&where, &device) == VKDENOISE_STATUS_OK);
  EXPECT(vkdenoise_denoiser_create(device, NULL, &denoiser) == VKDENOISE_STATUS_OK);
  device_arguments(device);
  denoiser_arguments(device, denoiser);
  planes(denoiser);
  versions(denoiser);
  strides(denoiser);
  threads(denoiser);
  vkdenoise_denoiser_destroy(denoiser);
  vkdenoise_device_destroy(device);
  lifetimes();
  if (failures > 0) return fprintf(stderr, "%d expectations failed\n", failures), 1;
  puts("all as it should be");
  return 0;
}
