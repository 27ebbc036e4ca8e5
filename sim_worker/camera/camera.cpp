#include "sim_worker/camera/camera.h"

// libOSMesa exports every GL function it implements, so prototypes are linked directly and no
// loader is needed.
#define GL_GLEXT_PROTOTYPES
#include <GL/osmesa.h>
// glext.h needs gl.h, which osmesa.h includes.
#include <GL/glext.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "core/check.h"
#include "core/constants.h"
#include "sim_worker/camera/camera_shaders.h"
#include "sim_worker/camera/camera_surfaces.h"

namespace omentum {
namespace {

constexpr double kToolLength = 0.25;  // [m] of shaft drawn at least, so that its end is out of view
constexpr double kPictureFar = 2.0;   // [m] far plane of shaded pictures
constexpr double kPictureNear = 0.005;  // [m]
GLuint compile(GLenum kind, const char* source) {
  const GLuint shader = glCreateShader(kind);
  glShaderSource(shader, 1, &source, nullptr);
  glCompileShader(shader);
  GLint compiled = 0;
  glGetShaderiv(shader, GL_COMPILE_STATUS, &compiled);
  if (compiled == 0) {
    std::array<char, 1024> text{};
    glGetShaderInfoLog(shader, static_cast<GLsizei>(text.size()), nullptr, text.data());
    throw_error("camera shader: {}", text.data());
  }
  return shader;
}

Eigen::Matrix4f projection_from_world(const CameraPose& pose, double aspect) {
  const double f = 1 / std::tan(pose.vertical_fov_rad / 2);
  const double near = pose.near_m;
  const double far = pose.far_m;
  Eigen::Matrix4d projection = Eigen::Matrix4d::Zero();
  projection(0, 0) = f / aspect;
  projection(1, 1) = f;
  projection(2, 2) = (far + near) / (near - far);
  projection(2, 3) = 2 * far * near / (near - far);
  projection(3, 2) = -1;
  Eigen::Matrix4d view = Eigen::Matrix4d::Identity();  // X_CW
  view.topLeftCorner<3, 3>() = pose.R_WC.transpose();
  view.topRightCorner<3, 1>() = -pose.R_WC.transpose() * pose.position;
  return (projection * view).cast<float>();
}

ObjectId id_of(pb::BodyRole role) {
  switch (role) {
    case pb::ROLE_TUMOUR:
      return ObjectId::kTumour;
    case pb::ROLE_OBSTACLE:
      return ObjectId::kObstacle;
    case pb::ROLE_BOARD:
      return ObjectId::kBoard;
    case pb::ROLE_ORGAN:
      break;
  }
  return ObjectId::kOrgan;
}

}  // namespace

CameraPose look_at(const Eigen::Vector3d& eye, const Eigen::Vector3d& target,
                   const Eigen::Vector3d& up, double vertical_fov_rad) {
  CameraPose pose;
  pose.position = eye;
  const Eigen::Vector3d z = (eye - target).normalized();
  Eigen::Vector3d x = up.cross(z);
  x = x.norm() > 1e-9 ? Eigen::Vector3d(x.normalized()) : z.unitOrthogonal();
  pose.R_WC.col(0) = x;
  pose.R_WC.col(1) = z.cross(x);
  pose.R_WC.col(2) = z;
  pose.vertical_fov_rad = vertical_fov_rad;
  return pose;
}

/// Everything that touches OpenGL.
class Camera::Renderer {
 public:
  Renderer(const Scene& scene, int image_width, int image_height, int samples)
      : width(image_width), height(image_height), supersample(samples), endoscope(scene.camera) {
    OMENTUM_CHECK(width > 0 && height > 0 && samples > 0 && samples <= 8, "{} x {}, {} samples",
                  width, height, samples);
    triangles_ = scene.tissue.surface_triangles;
    rim_ = find_rim(triangles_);
    rest_ =
        scene.tissue.surface_is_particles ? scene.tissue.particles : scene.tissue.surface_vertices;
    // A body sampled through its volume has a closed surface and needs no thickness in pictures.
    thickness_ = scene.tissue.surface_is_particles ? scene.tissue.thickness : 0;
    if (scene.soft_body) {
      const TissueBody& soft = scene.soft_body->body;
      soft_id_ = id_of(scene.soft_body->role);
      soft_triangles_ = soft.surface_triangles;
      soft_rest_ = soft.particles;
      for (const Eigen::Vector3d& p : soft.particles) {
        const Eigen::Vector3f p_W = (soft.X_WB * p).cast<float>();
        soft_rest_W_.insert(soft_rest_W_.end(), p_W.data(), p_W.data() + 3);
      }
    }
    const pb::Tool& tool = scene.config.tool();
    shaft_radius_ = tool.shaft_radius_m();
    shaft_start_ = tool.shaft_start_m();
    create_context();
    const Binding binding(*this);
    create_program();
    const Eigen::AlignedBox3d workspace(scene.workspace_min, scene.workspace_max);
    bool has_board = false;
    for (const RigidShape& body : scene.bodies) {
      add_body(make_body_surface(body, workspace), id_of(body.role));
      has_board = has_board || body.role == pb::ROLE_BOARD;
    }
    if (!has_board) {
      RigidShape board;  // the calibration board is the plane z = 0 of W
      board.kind = RigidShape::Kind::kHalfSpace;
      add_body(make_body_surface(board, workspace), ObjectId::kBoard);
    }
    moving_ = make_buffers();
  }

  ~Renderer() { OSMesaDestroyContext(context_); }  // frees buffers, textures and programs
  Renderer(const Renderer&) = delete;
  Renderer& operator=(const Renderer&) = delete;

  /// Draws into a target of w x h pixels and reads it back, top row first.
  Image draw(const CameraFrame& frame, const CameraPose& pose, int w, int h, bool shaded) {
    const Binding binding(*this);
    render(frame, pose, w, h, shaded, shaded);
    return read_back(w, h, shaded ? 3 : 1);
  }

  DepthImage draw_depth(const CameraFrame& frame, const CameraPose& pose, int w, int h) {
    const Binding binding(*this);
    render(frame, pose, w, h, false, true);
    DepthImage image{read_back(w, h, 1), {}};
    std::vector<float> raw(w * h);
    glReadPixels(0, 0, w, h, GL_DEPTH_COMPONENT, GL_FLOAT, raw.data());
    OMENTUM_CHECK(glGetError() == GL_NO_ERROR, "OpenGL error while reading depth");
    const double near = pose.near_m;
    const double far = pose.far_m;
    for (int y = h - 1; y >= 0; --y) {  // OpenGL counts rows from the bottom
      for (int x = 0; x < w; ++x) {
        // Inverse of the third row of projection_from_world.
        const auto z = static_cast<double>(raw[x + w * y]);
        image.depth_m.push_back(z < 1 ? static_cast<float>(near * far / (far - z * (far - near)))
                                      : 0.0F);
      }
    }
    return image;
  }

  const int width, height, supersample;
  const CameraPose endoscope;

 private:
  struct Buffers {
    GLuint array = 0, vertices = 0, indices = 0;
  };
  struct Target {
    GLuint framebuffer = 0, colour = 0, depth = 0;
  };
  struct Body {
    Buffers buffers;
    GLsizei count = 0;
    ObjectId id = ObjectId::kOrgan;
  };

  /// Makes the context current in this thread for the length of a call.
  class Binding {
   public:
    explicit Binding(Renderer& renderer) {
      const GLboolean bound = OSMesaMakeCurrent(renderer.context_, renderer.window_.data(),
                                                GL_UNSIGNED_BYTE, kWindow, kWindow);
      OMENTUM_CHECK(bound == GL_TRUE, "OSMesaMakeCurrent failed");
    }
    ~Binding() { OSMesaMakeCurrent(nullptr, nullptr, 0, 0, 0); }
    Binding(const Binding&) = delete;
    Binding& operator=(const Binding&) = delete;
  };

  void render(const CameraFrame& frame, const CameraPose& pose, int w, int h, bool shaded,
              bool thick) {
    prepare_targets(w, h);
    glViewport(0, 0, w, h);
    glEnable(GL_DEPTH_TEST);
    glDisable(GL_CULL_FACE);
    glDisable(GL_DITHER);
    glUseProgram(program_);
    const Eigen::Matrix4f matrix = projection_from_world(pose, double(w) / h);
    glUniformMatrix4fv(uniform("projection_from_world"), 1, GL_FALSE, matrix.data());
    const Eigen::Vector3f eye = pose.position.cast<float>();
    glUniform3fv(uniform("eye"), 1, eye.data());
    const Eigen::Vector3f side =
        (pose.R_WC * Eigen::Vector3d(-0.75, 0.65, 0.35)).normalized().cast<float>();
    glUniform3fv(uniform("side_light"), 1, side.data());
    glUniform1i(uniform("shaded"), shaded ? 1 : 0);
    draw_background(matrix, w, h, shaded);
    const std::size_t of_sheet = std::min(3 * rest_.size(), frame.tissue_vertices_W.size());
    if (of_sheet > 0) {
      draw_moving(make_tissue_surface(frame.tissue_vertices_W.first(of_sheet), rest_, triangles_,
                                      rim_, thick ? thickness_ : 0, frame.lower_face_W),
                  ObjectId::kTissue);
    }
    if (!soft_rest_.empty()) {
      const std::span<const float> given = frame.tissue_vertices_W.subspan(of_sheet);
      draw_moving(make_tissue_surface(given.empty() ? soft_rest_W_ : given, soft_rest_,
                                      soft_triangles_, {}, 0),
                  soft_id_);
    }
    if (frame.tool) draw_moving(tool_surface(*frame.tool), ObjectId::kTool);
  }

  /// The rigid bodies, which are most of the triangles and never move: drawn once for a view, then
  /// copied, colours and depths, into every picture of it.
  void draw_background(const Eigen::Matrix4f& matrix, int w, int h, bool shaded) {
    if (!background_drawn_ || matrix != background_matrix_ || shaded != background_shaded_) {
      glBindFramebuffer(GL_FRAMEBUFFER, background_.framebuffer);
      shaded ? glClearColor(0.055F, 0.06F, 0.075F, 1) : glClearColor(0, 0, 0, 1);
      glClear(GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT);
      for (const Body& body : bodies_) draw_buffers(body.buffers, body.count, body.id);
      background_drawn_ = true;
      background_matrix_ = matrix;
      background_shaded_ = shaded;
    }
    glBindFramebuffer(GL_READ_FRAMEBUFFER, background_.framebuffer);
    glBindFramebuffer(GL_DRAW_FRAMEBUFFER, target_.framebuffer);
    glBlitFramebuffer(0, 0, w, h, 0, 0, w, h, GL_COLOR_BUFFER_BIT | GL_DEPTH_BUFFER_BIT,
                      GL_NEAREST);
    glBindFramebuffer(GL_FRAMEBUFFER, target_.framebuffer);
  }

  /// The tool moves without turning but for its jaws, which take few angles: made once per angle
  /// with the tip in the origin, then shifted.
  DrawSurface tool_surface(const ToolPose& pose) {
    const auto same = [&pose](const auto& made) {
      return made.first.jaw_rad == pose.jaw_rad && made.first.roll_rad == pose.roll_rad &&
             made.first.shaft_axis_W == pose.shaft_axis_W;
    };
    auto found = std::find_if(tools_.begin(), tools_.end(), same);
    if (found == tools_.end()) {
      constexpr std::size_t kMost = 32;
      if (tools_.size() >= kMost) tools_.clear();
      ToolPose at_origin = pose;
      at_origin.p_WT.setZero();
      tools_.emplace_back(at_origin,
                          make_tool_surface(at_origin, shaft_radius_, shaft_start_, kToolLength));
      found = tools_.end() - 1;
    }
    DrawSurface surface = found->second;
    const Eigen::Vector3f tip = pose.p_WT.cast<float>();
    for (DrawSurface::Vertex& vertex : surface.vertices) vertex.position += tip;
    return surface;
  }

  GLint uniform(const char* name) const { return glGetUniformLocation(program_, name); }

  void create_context() {
    // clang-format off
    const int attributes[] = {OSMESA_FORMAT, OSMESA_RGBA, OSMESA_PROFILE, OSMESA_CORE_PROFILE,
                              OSMESA_CONTEXT_MAJOR_VERSION, 3, OSMESA_CONTEXT_MINOR_VERSION, 3, 0};
    // clang-format on
    context_ = OSMesaCreateContextAttribs(attributes, nullptr);
    if (context_ == nullptr) throw_error("OSMesa offers no OpenGL 3.3 core context");
  }

  void create_program() {
    const GLuint vertex = compile(GL_VERTEX_SHADER, kVertexShader);
    const GLuint fragment = compile(GL_FRAGMENT_SHADER, kFragmentShader);
    program_ = glCreateProgram();
    glAttachShader(program_, vertex);
    glAttachShader(program_, fragment);
    glLinkProgram(program_);
    GLint linked = 0;
    glGetProgramiv(program_, GL_LINK_STATUS, &linked);
    OMENTUM_CHECK(linked != 0, "camera program does not link");
    glDeleteShader(vertex);
    glDeleteShader(fragment);
    for (Target* target : {&target_, &background_}) {
      glGenFramebuffers(1, &target->framebuffer);
      glGenRenderbuffers(1, &target->colour);
      glGenRenderbuffers(1, &target->depth);
    }
  }

  void prepare_targets(int w, int h) {
    if (w == target_width_ && h == target_height_) return;
    for (const Target& target : {target_, background_}) {
      glBindFramebuffer(GL_FRAMEBUFFER, target.framebuffer);
      glBindRenderbuffer(GL_RENDERBUFFER, target.colour);
      glRenderbufferStorage(GL_RENDERBUFFER, GL_RGBA8, w, h);
      glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_COLOR_ATTACHMENT0, GL_RENDERBUFFER,
                                target.colour);
      glBindRenderbuffer(GL_RENDERBUFFER, target.depth);
      glRenderbufferStorage(GL_RENDERBUFFER, GL_DEPTH_COMPONENT32F, w, h);
      glFramebufferRenderbuffer(GL_FRAMEBUFFER, GL_DEPTH_ATTACHMENT, GL_RENDERBUFFER, target.depth);
      OMENTUM_CHECK(glCheckFramebufferStatus(GL_FRAMEBUFFER) == GL_FRAMEBUFFER_COMPLETE,
                    "target of {} x {} pixels", w, h);
    }
    target_width_ = w;
    target_height_ = h;
    background_drawn_ = false;
  }

  static Buffers make_buffers() {
    Buffers buffers;
    glGenVertexArrays(1, &buffers.array);
    glGenBuffers(1, &buffers.vertices);
    glGenBuffers(1, &buffers.indices);
    return buffers;
  }

  static void upload(const Buffers& buffers, const DrawSurface& surface, GLenum usage) {
    glBindVertexArray(buffers.array);
    glBindBuffer(GL_ARRAY_BUFFER, buffers.vertices);
    glBufferData(GL_ARRAY_BUFFER,
                 static_cast<GLsizeiptr>(surface.vertices.size() * sizeof(DrawSurface::Vertex)),
                 surface.vertices.data(), usage);
    glBindBuffer(GL_ELEMENT_ARRAY_BUFFER, buffers.indices);
    glBufferData(GL_ELEMENT_ARRAY_BUFFER,
                 static_cast<GLsizeiptr>(surface.indices.size() * sizeof(std::uint32_t)),
                 surface.indices.data(), usage);
    constexpr std::array<std::size_t, 3> kOffsets = {offsetof(DrawSurface::Vertex, position),
                                                     offsetof(DrawSurface::Vertex, normal),
                                                     offsetof(DrawSurface::Vertex, texture)};
    for (GLuint location = 0; location < kOffsets.size(); ++location) {
      glEnableVertexAttribArray(location);
      // OpenGL names an offset by a pointer. NOLINTNEXTLINE(performance-no-int-to-ptr)
      const void* offset = reinterpret_cast<const void*>(kOffsets[location]);
      glVertexAttribPointer(location, 3, GL_FLOAT, GL_FALSE, sizeof(DrawSurface::Vertex), offset);
    }
  }

  void add_body(const DrawSurface& surface, ObjectId id) {
    bodies_.push_back({make_buffers(), static_cast<GLsizei>(surface.indices.size()), id});
    upload(bodies_.back().buffers, surface, GL_STATIC_DRAW);
  }

  void draw_moving(const DrawSurface& surface, ObjectId id) {
    upload(moving_, surface, GL_STREAM_DRAW);
    draw_buffers(moving_, static_cast<GLsizei>(surface.indices.size()), id);
  }

  void draw_buffers(const Buffers& buffers, GLsizei count, ObjectId id) {
    glUniform1i(uniform("object_id"), static_cast<GLint>(id));
    glBindVertexArray(buffers.array);
    glDrawElements(GL_TRIANGLES, count, GL_UNSIGNED_INT, nullptr);
  }

  Image read_back(int w, int h, int channels) {
    std::vector<std::uint8_t> raw(4 * w * h);
    glPixelStorei(GL_PACK_ALIGNMENT, 4);
    glReadPixels(0, 0, w, h, GL_RGBA, GL_UNSIGNED_BYTE, raw.data());
    OMENTUM_CHECK(glGetError() == GL_NO_ERROR, "OpenGL error while drawing");
    Image image{w, h, channels, {}};
    for (int y = h - 1; y >= 0; --y) {  // OpenGL counts rows from the bottom
      for (int x = 0; x < w; ++x) {
        const auto pixel = raw.begin() + 4 * (x + w * y);
        image.pixels.insert(image.pixels.end(), pixel, pixel + channels);
      }
    }
    return image;
  }

  static constexpr int kWindow = 4;  // pixels; pictures go to a target of their own
  std::array<std::uint8_t, 4 * kWindow * kWindow> window_{};
  OSMesaContext context_ = nullptr;
  GLuint program_ = 0;
  Target target_, background_;
  int target_width_ = 0, target_height_ = 0;
  bool background_drawn_ = false, background_shaded_ = false;
  Eigen::Matrix4f background_matrix_ = Eigen::Matrix4f::Zero();
  std::vector<Body> bodies_;
  Buffers moving_;
  std::vector<std::pair<ToolPose, DrawSurface>> tools_;  ///< by their pose, but for the tip
  std::vector<Eigen::Vector3i> triangles_;
  std::vector<Edge> rim_;
  std::vector<Eigen::Vector3d> rest_;
  ObjectId soft_id_ = ObjectId::kOrgan;
  std::vector<Eigen::Vector3i> soft_triangles_;
  std::vector<Eigen::Vector3d> soft_rest_;
  std::vector<float> soft_rest_W_;  ///< drawn where a frame holds no state
  double thickness_ = 0, shaft_radius_ = 0, shaft_start_ = 0;
};

Camera::Camera(const Scene& scene, int width, int height, int supersample)
    : renderer_(std::make_unique<Renderer>(scene, width, height, supersample)) {}

Camera::~Camera() = default;

const CameraPose& Camera::endoscope() const { return renderer_->endoscope; }

Image Camera::draw_shaded(const CameraFrame& frame, const CameraPose& pose) {
  CameraPose wide = pose;
  wide.near_m = std::min(pose.near_m, kPictureNear);
  wide.far_m = std::max(pose.far_m, kPictureFar);
  const int n = renderer_->supersample;
  const Image fine =
      renderer_->draw(frame, wide, n * renderer_->width, n * renderer_->height, true);
  Image image{renderer_->width, renderer_->height, 3, {}};
  for (int y = 0; y < image.height; ++y) {
    for (int x = 0; x < image.width; ++x) {
      for (std::size_t c = 0; c < 3; ++c) {
        int sum = 0;
        for (int k = 0; k < n * n; ++k)
          sum += fine.pixels[fine.offset(n * x + k % n, n * y + k / n) + c];
        image.pixels.push_back(static_cast<std::uint8_t>((sum + n * n / 2) / (n * n)));
      }
    }
  }
  return image;
}

Image Camera::draw_ids(const CameraFrame& frame) {
  return draw_ids(frame, renderer_->endoscope, renderer_->width, renderer_->height);
}

Image Camera::draw_ids(const CameraFrame& frame, const CameraPose& pose, int width, int height) {
  return renderer_->draw(frame, pose, width, height, false);
}

DepthImage Camera::draw_depth(const CameraFrame& frame, const CameraPose& pose, int width,
                              int height) {
  return renderer_->draw_depth(frame, pose, width, height);
}

}  // namespace omentum
