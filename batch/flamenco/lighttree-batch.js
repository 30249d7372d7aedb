// SPDX-License-Identifier: GPL-3.0-or-later
//
// A job type for Flamenco 3: a batch of LightTree, one task an image.
//
// `lighttree batch JOBS.toml --flamenco http://MANAGER:8080` submits it. This file goes into the
// folder `scripts` beside the program flamenco-manager; a Manager reads it at each submission.
//
// Timed images must be alone on their machine. A Worker does one task at a time, so this holds
// where a machine runs one Worker and nothing else that computes.

const JOB_TYPE = {
    label: "LightTree Batch",
    description: "Compare LightTree with Cycles: one task an image, then the report",
    settings: [
        { key: "job_file", type: "string", subtype: "file_path", required: true,
          description: "JOBS.toml, in storage that all Workers share" },
        { key: "lighttree", type: "string", required: true, default: "lighttree",
          description: "Program that Workers start: lighttree, or a variable like {lighttree}" },
        { key: "units", type: "string", required: true, visible: "hidden",
          description: "Images to render, one a line: its key and its name" },
    ],
};

function compileJob(job) {
    const settings = job.settings;
    const units = (settings.units || "").split("\n").filter(function (line) {
        return line.trim() !== "";
    });
    if (!settings.job_file || units.length === 0) {
        throw "This job knows no images; submit it with: lighttree batch JOBS.toml --flamenco URL";
    }

    // In this order, since neighbours are compared with each other.
    const renders = units.map(function (line) {
        const words = line.trim().split(" ");
        return authorTask(settings, words.slice(1).join(" "), ["--unit", words[0]]);
    });
    const report = authorTask(settings, "report", []);
    renders.forEach(function (task) {
        report.addDependency(task);
        job.addTask(task);
    });
    job.addTask(report);
}

// All need the same of a Worker: the report also renders what is missing by then.
function authorTask(settings, name, options) {
    const task = author.Task(name, "blender");
    task.addCommand(author.Command("exec", {
        exe: settings.lighttree || "lighttree",
        args: ["batch", settings.job_file].concat(options),
    }));
    return task;
}
