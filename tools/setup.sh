# Installs what is missing on a Debian machine that has only rustup's toolchain. Sourced by tools/demo and tools/test.

# Cargo's output lives outside the checkout: the shader compiler takes 15 minutes to build on two cores, once.
export CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-${XDG_CACHE_HOME:-$HOME/.cache}/vkdenoise/target}

# need COMMAND-OR-FILE PACKAGE...: installs the packages where the command or file is missing.
need() {
  local wanted=$1; shift
  command -v "$wanted" >/dev/null 2>&1 || [ -e "$wanted" ] || missing+=("$@")
}

install_missing() {
  [ ${#missing[@]} -gt 0 ] || return 0
  echo "installing: ${missing[*]}" >&2
  local root=()
  [ "$(id -u)" = 0 ] || root=(sudo)
  command -v apt-get >/dev/null || { echo "install these with your package manager: ${missing[*]}" >&2; exit 1; }
  "${root[@]}" apt-get update -qq
  DEBIAN_FRONTEND=noninteractive "${root[@]}" apt-get install -y -qq --no-install-recommends "${missing[@]}" >&2
}

missing=()
command -v cargo >/dev/null || { echo "install Rust with rustup first: https://rustup.rs" >&2; exit 1; }
need cc gcc libc6-dev
need c++ g++
need cmake cmake
need ninja ninja-build
need python3 python3
need git git
libraries=/usr/lib/$(uname -m)-linux-gnu
need "$libraries/libvulkan.so.1" libvulkan1
# Any Vulkan driver will do; without one, lavapipe, which runs on the CPU.
compgen -G '/usr/share/vulkan/icd.d/*.json' >/dev/null || compgen -G '/etc/vulkan/icd.d/*.json' >/dev/null ||
  [ -n "${VK_DRIVER_FILES:-${VK_ICD_FILENAMES:-}}" ] || missing+=(mesa-vulkan-drivers)
