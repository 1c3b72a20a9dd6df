// The robot with a metric on it, to turn around: plain WebGL, so that the report needs no other file.
(() => {
  const data = JSON.parse(document.getElementById('robot-data').textContent);
  const canvas = document.getElementById('robot');
  const gl = canvas.getContext('webgl', { antialias: true, preserveDrawingBuffer: true });
  if (!gl) { canvas.replaceWith('This browser has no WebGL; the pictures below show the same.'); return; }
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

  const compile = (type, source) => {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    return shader;
  };
  const program = gl.createProgram();
  gl.attachShader(program, compile(gl.VERTEX_SHADER, `
    attribute vec3 p, n, c; uniform mat3 R; uniform vec3 middle; uniform float aspect, far; varying vec3 rgb;
    void main() {
      vec3 q = R * (p - middle);
      gl_Position = vec4(2.2 * q.x / aspect, 2.2 * q.y, (far - q.z) * 1.02 - 0.4, far - q.z);
      rgb = c * (0.45 + 0.55 * max(0.0, (R * normalize(n)).z));
    }`));
  gl.attachShader(program, compile(gl.FRAGMENT_SHADER, `
    precision mediump float; varying vec3 rgb; void main() { gl_FragColor = vec4(rgb, 1.0); }`));
  gl.linkProgram(program);
  gl.useProgram(program);

  const attribute = (name, values, type, normalized) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    const at = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 3, type, normalized, 0, 0);
  };
  attribute('p', bytes(data.vertices), gl.FLOAT, false);
  attribute('n', new Int8Array(bytes(data.normals).buffer), gl.BYTE, true);
  const faces = bytes(data.faces);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
  gl.enable(gl.DEPTH_TEST);

  let azimuth = -1.2, height = 0.25, far = 1.4;  // as seen from before the robot, a little from above
  const draw = () => {
    const ratio = window.devicePixelRatio || 1;
    canvas.width = canvas.clientWidth * ratio;
    canvas.height = canvas.clientHeight * ratio;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.933, 0.945, 0.957, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const [s, c, t, d] = [Math.sin(azimuth), Math.cos(azimuth), Math.sin(height), Math.cos(height)];
    // columns: where the world's x, y and z go; the camera looks along its own -z
    gl.uniformMatrix3fv(gl.getUniformLocation(program, 'R'), false, [-s, -t * c, d * c, c, -t * s, d * s, 0, d, t]);
    gl.uniform3fv(gl.getUniformLocation(program, 'middle'), data.middle);
    gl.uniform1f(gl.getUniformLocation(program, 'aspect'), canvas.width / canvas.height);
    gl.uniform1f(gl.getUniformLocation(program, 'far'), far);
    gl.drawElements(gl.TRIANGLES, faces.length / 2, gl.UNSIGNED_SHORT, 0);
  };

  const legend = document.createElement('span');
  const show = (field) => {
    attribute('c', bytes(field.colours), gl.UNSIGNED_BYTE, true);
    const [low, high] = field.scale.map((x) => x.toPrecision(3));
    legend.innerHTML = `${low}<span class="scale" style="background:linear-gradient(90deg,${data.ramp})"></span>${high} ${field.unit}`;
    buttons.forEach((button) => button.setAttribute('aria-pressed', button.textContent === field.name));
    draw();
  };
  const buttons = data.fields.map((field) => {
    const button = document.createElement('button');
    button.textContent = field.name;
    button.onclick = () => show(field);
    canvas.parentNode.append(button);
    return button;
  });
  canvas.parentNode.append(legend);

  canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
  canvas.onpointermove = (event) => {
    if (!event.buttons) return;
    azimuth -= 0.01 * event.movementX;
    height = Math.max(-1.5, Math.min(1.5, height + 0.01 * event.movementY));
    draw();
  };
  canvas.onwheel = (event) => {
    event.preventDefault();
    far = Math.max(0.5, Math.min(4, far * Math.exp(0.001 * event.deltaY)));
    draw();
  };
  window.addEventListener('resize', draw);
  show(data.fields[0]);
})();
