// The client reads its messages between two frames of its 3D view, and a browser without WebGL draws none: panels, banner,
// plots and images would stay away with it. So there it gets a context that takes everything and draws nothing.
(() => {
  const native = HTMLCanvasElement.prototype.getContext;
  const isWebGL = (kind) => /webgl/.test(kind);
  try {
    if (native.call(document.createElement("canvas"), "webgl2")) return;
  } catch {} // some browsers raise what others answer with null
  const constants = window.WebGL2RenderingContext ?? {};
  const STATUS = 1, NONE = 0, FULL = 0x8cd5;
  const empty = (canvas) => {
    const answers = {
      canvas,
      drawingBufferWidth: 1,
      drawingBufferHeight: 1,
      getContextAttributes: () => ({ alpha: true, antialias: false, depth: true, stencil: false }),
      getSupportedExtensions: () => [],
      getShaderPrecisionFormat: () => ({ rangeMin: 127, rangeMax: 127, precision: 23 }),
      getShaderInfoLog: () => "",
      getProgramInfoLog: () => "",
      getShaderParameter: () => STATUS,
      getProgramParameter: (_, name) => (name === constants.LINK_STATUS ? STATUS : NONE),
      getParameter: (name) => {
        if (name === constants.VERSION) return "WebGL 2.0";
        if (name === constants.SHADING_LANGUAGE_VERSION) return "WebGL GLSL ES 3.00";
        if (name === constants.VIEWPORT || name === constants.SCISSOR_BOX) return [0, 0, 1, 1];
        return 4096;
      },
      checkFramebufferStatus: () => FULL,
      getAttribLocation: () => -1,
      getError: () => NONE,
      isContextLost: () => false,
    };
    return new Proxy(answers, {
      get(known, name) {
        if (name in known) return known[name];
        if (typeof name !== "string") return undefined;
        if (/^[A-Z]/.test(name)) return constants[name];
        return name.startsWith("create") ? () => ({}) : () => null;
      },
    });
  };
  const made = new WeakMap();
  HTMLCanvasElement.prototype.getContext = function (kind, ...options) {
    if (!isWebGL(kind)) return native.call(this, kind, ...options);
    if (!made.has(this)) made.set(this, empty(this));
    return made.get(this);
  };
  addEventListener("DOMContentLoaded", () => {
    const note = document.createElement("div");
    note.className = "eb-nogl";
    note.setAttribute("role", "alert");
    note.textContent = "This browser has no WebGL, so there is no 3D view. All else works: banner, plots, images and buttons.";
    document.body.append(note);
  });
})();
