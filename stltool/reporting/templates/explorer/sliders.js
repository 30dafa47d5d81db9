/* The sliders for the step and for what is remembered. */

const sliders = {};
function buildSliders() {
  const make = (id, name, input) => {
    const box = el("input", {
      type: "range",
      id,
      min: 0,
      step: 1,
      oninput: (event) => input(Number(event.target.value)),
    });
    const out = el("output", { for: id });
    $("sliders").append(el("div", { class: "slider" }, el("label", { for: id }, name), box, out));
    return { box, out, levels: [] };
  };
  sliders.step = make("step", "Step", (t) => {
    stop();
    go(t, following() && at(t) ? before(t) : nearestMemory(t, view.m));
  });
  sliders.step.box.max = M.h;
  sliders.parts = [];
  if (tracks.every((track) => track.phrases.length < 2)) return;
  sliders.parts = tracks.map((track, i) =>
    make(`part${i}`, track.name, (k) => {
      stop();
      view.m = nearestMemory(view.t, view.m, i, sliders.parts[i].levels[k]);
      view.s = null;
      draw();
    }),
  );
  const box = el("input", {
    type: "checkbox",
    id: "fill",
    onchange: (event) => {
      view.fill = event.target.checked;
      view.s = null;
      draw();
    },
  });
  box.checked = true;
  $("sliders").append(el("label", { class: "tickbox" }, box, `fill the other ${place}s with the nearest memory`));
}
function drawSliders() {
  const set = (slider, value, text) => {
    slider.box.value = value;
    slider.out.textContent = text;
    slider.box.setAttribute("aria-valuetext", text);
  };
  set(sliders.step, view.t, `step ${view.t} of ${M.h}`);
  sliders.parts.forEach((slider, i) => {
    const track = tracks[i];
    slider.levels = [...new Set(alive(view.t).map((q) => track.of[q]))].sort((a, b) => a - b);
    slider.box.max = Math.max(0, slider.levels.length - 1);
    slider.box.disabled = slider.levels.length < 2;
    set(slider, Math.max(0, slider.levels.indexOf(track.of[view.m])), track.phrases[track.of[view.m]]);
  });
  const back = (t) => el("button", { type: "button", class: "small", onclick: () => go(t) }, "Back to the run");
  const note = $("follow-note");
  if (following() && view.s === null)
    note.replaceChildren(`The picture: what if the run, with its past, were in another ${place} now.`);
  else if (following()) note.replaceChildren(`Same past, another ${place}. `, back(view.t));
  else note.replaceChildren("Another memory than the run's. ", back(Math.min(Math.max(view.t, run.start), end())));
}
