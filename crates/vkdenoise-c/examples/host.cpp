// The host path in C++: objects destroy themselves and errors are thrown. A noisy step between two greys is denoised,
// as a whole and then a region of it, which has the same bits, with progress; what ends a call early is shown last.

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <random>
#include <stdexcept>
#include <vector>
#include <vkdenoise.hpp>

namespace {

constexpr std::uint32_t kWidth = 96, kHeight = 64;

float truth(std::uint32_t x) { return x < kWidth / 2 ? 0.2f : 0.7f; }

vkdenoise_plane plane(const std::vector<float>& samples) {
  auto plane = vkdenoise::make<vkdenoise_plane>();
  plane.samples = samples.data();
  plane.size = samples.size() * sizeof(float);
  return plane;
}

vkdenoise_plane_mut plane_mut(std::vector<float>& samples) {
  auto plane = vkdenoise::make<vkdenoise_plane_mut>();
  plane.samples = samples.data();
  plane.size = samples.size() * sizeof(float);
  return plane;
}

double error_of(const std::vector<float>& samples) {
  double sum = 0.0;
  for (std::size_t i = 0; i < samples.size(); i++) sum += std::abs(samples[i] - truth(i / 3 % kWidth));
  return sum / samples.size();
}

int run() {
  for (const auto& info : vkdenoise::devices()) {
    std::printf("%u: %s (%s)%s%s\n", info.index, info.name, info.driver, *info.missing ? ", lacks " : "", info.missing);
  }
  std::mt19937 random(1);
  std::exponential_distribution<float> noise(1.0f);
  std::vector<float> noisy(3 * kWidth * kHeight), albedo(noisy.size()), clean(noisy.size()), part(noisy.size(), -1.0f);
  for (std::size_t pixel = 0; pixel < noisy.size() / 3; pixel++) {
    const float factor = noise(random);
    for (std::size_t i = 3 * pixel; i < 3 * pixel + 3; i++) {
      albedo[i] = truth(pixel % kWidth);
      noisy[i] = factor * albedo[i];
    }
  }

  auto where = vkdenoise::make<vkdenoise_device_options>();
  where.device = std::getenv("VKDENOISE_DEVICE");
  vkdenoise::Denoiser denoiser{vkdenoise::Device(where)};
  const auto color = plane(noisy), guide = plane(albedo);
  auto output = plane_mut(clean);
  auto frame = vkdenoise::make<vkdenoise_frame>();
  frame.width = kWidth;
  frame.height = kHeight;
  frame.color = &color;
  frame.albedo = &guide;
  frame.output = &output;
  const auto report = denoiser.denoise(frame);

  auto region_output = plane_mut(part);
  frame.output = &region_output;
  auto options = vkdenoise::make<vkdenoise_frame_options>();
  options.region = {32, 16, 24, 8};
  float done = 0.0f;
  denoiser.denoise(frame, options, [&](float share) {
    done = share;
    return true;
  });
  if (done != 1.0f) {
    std::fprintf(stderr, "the last share of the work was %g\n", done);
    return 1;
  }

  std::printf("%.1f ms; mean error: noisy %.4f, denoised %.4f\n", report.total_ms, error_of(noisy), error_of(clean));
  for (std::size_t i = 0; i < part.size(); i++) {
    const std::size_t x = i / 3 % kWidth, y = i / 3 / kWidth;
    const bool inside = 32 <= x && x < 56 && 16 <= y && y < 24;
    if (part[i] != (inside ? clean[i] : -1.0f)) {
      std::fprintf(stderr, "sample %zu of the region is %g, of the whole frame %g\n", i, part[i], clean[i]);
      return 1;
    }
  }
  if (!(error_of(clean) < error_of(noisy) / 5.0)) {
    std::fprintf(stderr, "the denoised frame is not a fifth as far from the truth as the noisy one\n");
    return 1;
  }

  // The user has seen enough, or a window is gone.
  try {
    denoiser.denoise(frame, options, [](float share) { return share == 0.0f; });
    return 1;
  } catch (const vkdenoise::Error& error) {
    if (error.status() != VKDENOISE_STATUS_CANCELLED) throw;
  }
  try {
    denoiser.denoise(frame, options, [](float) -> bool { throw std::out_of_range("the window is gone"); });
    return 1;
  } catch (const std::out_of_range& error) {
    std::printf("ended: %s\n", error.what());
  }

  // A frame that is too small for what it says it has.
  auto short_color = color;
  short_color.size -= 1;
  frame.color = &short_color;
  try {
    denoiser.denoise(frame);
  } catch (const vkdenoise::Error& error) {
    std::printf("as it should: %s\n", error.what());
    return error.status() == VKDENOISE_STATUS_PLANE_MISMATCH ? 0 : 1;
  }
  std::fprintf(stderr, "a plane that is too small was taken\n");
  return 1;
}

}  // namespace

int main() {
  try {
    return run();
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
}
