// Starts the language server `urscript lsp` and, for each session, the debug adapter `urscript dap`.

const vscode = require("vscode");
const { LanguageClient } = require("vscode-languageclient/node");

let client;

function command(...words) {
  const [program, ...first] = vscode.workspace.getConfiguration("urscript").get("command");
  return { command: program, args: [...first, ...words] };
}

async function activate(context) {
  const version = vscode.workspace.getConfiguration("urscript").get("polyscope");
  const server = command("lsp", ...(version ? ["--polyscope", version] : []));
  client = new LanguageClient("urscript", "URScript", server, {
    documentSelector: [{ language: "urscript" }],
  });
  const adapters = {
    createDebugAdapterDescriptor() {
      const adapter = command("dap");
      return new vscode.DebugAdapterExecutable(adapter.command, adapter.args);
    },
  };
  const defaults = {
    // F5 without a launch.json debugs the open file
    resolveDebugConfiguration(_folder, configuration) {
      const file = vscode.window.activeTextEditor?.document;
      if (configuration.type || file?.languageId !== "urscript") return configuration;
      return { type: "urscript", request: "launch", name: file.fileName, program: "${file}", stopOnEntry: true };
    },
  };
  context.subscriptions.push(
    vscode.debug.registerDebugAdapterDescriptorFactory("urscript", adapters),
    vscode.debug.registerDebugConfigurationProvider("urscript", defaults),
  );
  try {
    await client.start();
  } catch (error) {
    vscode.window.showErrorMessage(
      `${server.command} lsp did not start: install ur-emulator with its extra "editor", ` +
        `or set urscript.command (${error.message})`,
    );
  }
}

function deactivate() {
  return client?.stop();
}

module.exports = { activate, deactivate };
