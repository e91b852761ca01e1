// The host path in C: a noisy picture of a ball, made here, is denoised and held against the truth.
//
//   host [CLEAN.pfm]     writes noisy, denoised and true picture side by side, if a file is named
//
// VKDENOISE_DEVICE picks the device: a number or part of a name.

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <vkdenoise.h>

enum { WIDTH = 160, HEIGHT = 120, PIXELS = WIDTH * HEIGHT };

// A renderer's pixel, as it lies in memory: the planes are views of it with strides.
struct pixel {
  float color[3];
  float albedo[3];
  float normal[3];
  float depth;
};

static struct pixel frame[PIXELS];
static float truth[PIXELS][3];
static float denoised[PIXELS][3];

static float random01(void) {
  static uint32_t state = 1;
  state = state * 1664525u + 1013904223u;
  return (float)(state >> 8) / 16777216.0f;
}

static void render(void) {
  for (int i = 0; i < PIXELS; i++) {
    float x = (float)(i % WIDTH) / HEIGHT - 0.67f, y = (float)(i / WIDTH) / HEIGHT - 0.5f;
    float inside = 0.16f - x * x - y * y;
    struct pixel *p = &frame[i];
    if (inside > 0.0f) {
      float z = sqrtf(inside), radius = 0.4f;
      int stripe = (int)floorf((x + 1.0f) * 12.0f) % 2;
      p->normal[0] = x / radius, p->normal[1] = y / radius, p->normal[2] = z / radius;
      p->albedo[0] = stripe ? 0.8f : 0.2f, p->albedo[1] = 0.5f, p->albedo[2] = stripe ? 0.2f : 0.7f;
      p->depth = 3.0f - z;
    } else {
      p->normal[0] = 0.0f, p->normal[1] = 0.0f, p->normal[2] = 1.0f;
      p->albedo[0] = p->albedo[1] = p->albedo[2] = 0.6f;
      p->depth = 4.0f;
    }
    float light = 0.1f + 0.9f * fmaxf(0.0f, 0.6f * p->normal[2] - 0.5f * p->normal[1] - 0.4f * p->normal[0]);
    // Some samples of a path tracer: exponential noise about the mean.
    float noise = 0.0f;
    for (int s = 0; s < 4; s++) noise += -logf(1.0f - random01()) / 4.0f;
    for (int c = 0; c < 3; c++) {
      truth[i][c] = p->albedo[c] * light;
      p->color[c] = truth[i][c] * noise;
    }
  }
}

static double mean_square_error(const float *first, size_t stride) {
  double sum = 0.0;
  for (int i = 0; i < PIXELS; i++)
    for (int c = 0; c < 3; c++) {
      double difference = first[i * stride + c] - truth[i][c];
      sum += difference * difference;
    }
  return sum / (3.0 * PIXELS);
}

static int write_pfm(const char *path) {
  FILE *file = fopen(path, "wb");
  if (!file) return perror(path), 1;
  fprintf(file, "PF\n%d %d\n-1.0\n", 3 * WIDTH, HEIGHT);
  for (int y = HEIGHT - 1; y >= 0; y--) {
    for (int x = 0; x < WIDTH; x++) fwrite(frame[y * WIDTH + x].color, sizeof(float), 3, file);
    fwrite(denoised[y * WIDTH], sizeof(float), 3 * WIDTH, file);
    fwrite(truth[y * WIDTH], sizeof(float), 3 * WIDTH, file);
  }
  return fclose(file) ? (perror(path), 1) : 0;
}

static void check(vkdenoise_status status, const char *call) {
  if (status == VKDENOISE_STATUS_OK) return;
  fprintf(stderr, "%s: %s\n", call, vkdenoise_last_error());
  exit(1);
}

// A plane of the frame's pixels that begins at one of their members.
static vkdenoise_plane plane(const float *first) {
  vkdenoise_plane plane = VKDENOISE_INIT(vkdenoise_plane);
  plane.samples = first;
  plane.pixel_stride = sizeof(struct pixel);
  return plane;
}

int main(int argc, char **argv) {
  render();

  vkdenoise_device_options where = VKDENOISE_INIT(vkdenoise_device_options);
  where.device = getenv("VKDENOISE_DEVICE");
  vkdenoise_device *device;
  check(vkdenoise_device_open(&where, &device), "vkdenoise_device_open");

  vkdenoise_options options = VKDENOISE_INIT(vkdenoise_options);
  options.quality = VKDENOISE_QUALITY_BALANCED;
  vkdenoise_denoiser *denoiser;
  check(vkdenoise_denoiser_create(device, &options, &denoiser), "vkdenoise_denoiser_create");

  vkdenoise_plane color = plane(frame->color), albedo = plane(frame->albedo), normal = plane(frame->normal);
  vkdenoise_plane depth = plane(&frame->depth);
  vkdenoise_plane_mut output = VKDENOISE_INIT(vkdenoise_plane_mut);
  output.samples = denoised;
  output.size = sizeof denoised;

  vkdenoise_frame planes = VKDENOISE_INIT(vkdenoise_frame);
  planes.width = WIDTH;
  planes.height = HEIGHT;
  planes.color = &color;
  planes.albedo = &albedo;
  planes.normal = &normal;
  planes.depth = &depth;
  planes.output = &output;
  vkdenoise_report report = VKDENOISE_INIT(vkdenoise_report);
  check(vkdenoise_denoise(denoiser, &planes, NULL, &report), "vkdenoise_denoise");

  vkdenoise_device_info info = VKDENOISE_INIT(vkdenoise_device_info);
  check(vkdenoise_device_get_info(device, &info), "vkdenoise_device_get_info");
  double before = mean_square_error(frame->color, sizeof(struct pixel) / sizeof(float));
  double after = mean_square_error(denoised[0], 3);
  printf("vkdenoise %s on %s: exposure %.3f, %.1f ms, %.1f MB\n", vkdenoise_version(), info.name, report.exposure,
         report.total_ms, report.device_bytes / 1e6);
  printf("mean square error: noisy %.6f, denoised %.6f\n", before, after);

  vkdenoise_denoiser_destroy(denoiser);
  vkdenoise_device_destroy(device);
  if (argc > 1 && write_pfm(argv[1])) return 1;
  if (!(after < before / 10.0)) {
    fprintf(stderr, "the denoised picture is not a tenth as far from the truth as the noisy one\n");
    return 1;
  }
  return 0;
}
